"""Every format that is written keeps the picture of a real scene."""

from importlib.resources import files

import numpy as np
import pytest

import splatree
from splatree import Camera, Scene, psnr, render
from splatree.io.registry import formats


@pytest.fixture(scope="module")
def block() -> Scene:
    """A piece of the bundled city that is whole: the 20,000 Gaussians around its middle."""
    scene = splatree.read(str(files("splatree") / "data" / "semarang_5_9.sog"))
    means = scene.gaussians.means
    nearest = np.argsort(np.linalg.norm(means - np.median(means, axis=0), axis=1), kind="stable")[:20_000]
    return Scene.flat(scene.gaussians.take(np.sort(nearest)))


def picture(scene: Scene, block: Scene) -> np.ndarray:
    middle = np.median(block.gaussians.means, axis=0).astype(np.float64)
    return np.clip(render(scene, Camera.look_at(middle + [8, -25, -35], middle, width=240, height=135)).image, 0, 1)


@pytest.mark.parametrize("f", [f for f in formats() if f.is_written], ids=lambda f: f.name)
def test_the_picture_is_kept(tmp_path, block, f):
    path = tmp_path / f"a{f.suffixes[0]}"
    lost = splatree.write(block, path)
    back = splatree.read(path)
    degree = min(3, f.holds.sh_degree)
    wanted = picture(Scene.flat(block.gaussians.with_sh_degree(degree)), block)
    found = picture(back, block)
    assert wanted.std() > 0.1 and len(back) == len(block)
    assert psnr(found, wanted) >= 40  # the goal for all formats
    assert any(sentence.startswith("the harmonics") for sentence in lost) == (degree < 3)
    if f.holds.lossless:
        assert not lost and np.array_equal(found, wanted)
