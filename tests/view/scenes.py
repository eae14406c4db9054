"""Scenes to show: random, with levels and harmonics."""

from functools import lru_cache

from splatree.render.build import build_lod
from splatree.scene.scene import Scene
from splatree.view.exhibit import exhibit

from ..scenes import cloud


def gaussians(n=2000, degree=3):
    return cloud(n, 7, degree=degree, log_scales=("normal", -3.2, 0.6), logits=("normal", 1.0, 1.5), sh=0.25)


@lru_cache(maxsize=4)
def scene(n=2000, degree=3):
    return build_lod(Scene.flat(gaussians(n, degree)))


@lru_cache(maxsize=4)
def on_show(n=2000, degree=3):
    return exhibit(scene(n, degree))
