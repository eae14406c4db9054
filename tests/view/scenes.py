"""Scenes to show: random, with levels and harmonics."""

from functools import lru_cache

import numpy as np

from splatree.lod.build import build_lod
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.view.exhibit import exhibit


def gaussians(n=2000, degree=3, seed=7):
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.normal(0, 1, (n, 3)).astype(np.float32),
        rng.normal(0, 1, (n, 4)).astype(np.float32),
        rng.normal(-3.2, 0.6, (n, 3)).astype(np.float32),
        rng.normal(1, 1.5, n).astype(np.float32),
        rng.normal(0, 0.25, (n, (degree + 1) ** 2, 3)).astype(np.float32),
    )


@lru_cache(maxsize=4)
def scene(n=2000, degree=3):
    return build_lod(Scene.flat(gaussians(n, degree)))


@lru_cache(maxsize=4)
def on_show(n=2000, degree=3):
    return exhibit(scene(n, degree))
