from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.metrics.gain import psnr_with_gain
from splatree.render.evaluate import evaluate, score

from ..scenes import gaussians

CAMERAS = [
    st.Camera(view.camera_from_world, view.K, view.width, view.height, name=name)
    for name, x in (("left", -1.0), ("right", 1.0))
    for view in [st.Camera.look_at((x, 0, -5), (0, 0, 0), width=48, height=32)]
]


@pytest.fixture(scope="module")
def scene():
    return st.build_lod(st.Scene.flat(gaussians(400, 0)))


def test_pictures_are_compared_as_a_screen_shows_them():
    image, shown = np.full((12, 12, 3), 1.7, np.float32), np.ones((12, 12, 3), np.float32)
    image[0], shown[0] = -0.3, 0
    assert score(image, shown).psnr == score(shown, image).psnr == np.inf
    assert score(image, shown).ssim == pytest.approx(1)


@pytest.mark.parametrize(("shape", "has_ssim"), [((11, 11), True), ((10, 40), False), ((40, 10), False)])
def test_structure_needs_a_picture_of_a_window(shape, has_ssim):
    image = np.zeros((*shape, 3), np.float32)
    assert (score(image, image).ssim is not None) == has_ssim
    assert score(image, image).lpips is None
    assert score(image, image, lambda a, b: 0.25).lpips == 0.25


def test_a_cut_is_compared_with_all_leaves_drawn_without_loss(scene):
    lossy = st.RenderOptions(background=(0.2, 0.4, 0.6), threshold=0.3, tile_rule="tau")
    select = st.SelectOptions(pixel_error=20)
    leaves = st.SelectOptions(pixel_error=0)
    for found, camera in zip(evaluate(scene, CAMERAS, lossy, select), CAMERAS, strict=True):
        assert found.camera is camera
        assert np.array_equal(found.cut.result.image, st.render(scene, camera, lossy, select).image)
        lossless = st.render(scene, camera, st.RenderOptions(background=(0.2, 0.4, 0.6)), leaves).image
        assert np.array_equal(found.leaves.result.image, lossless)
        assert found.cut_vs_leaves == score(found.cut.result.image, lossless)
        assert found.cut_vs_leaves.psnr < 60  # they do differ
        assert found.cut_vs_photo is found.leaves_vs_photo is None


def test_photographs_are_found_by_the_name_of_the_camera(scene):
    photos = {"right": np.full((32, 48, 3), 0.25, np.float32)}
    left, right = evaluate(scene, CAMERAS, photos=photos)
    assert left.cut_vs_photo is left.leaves_vs_photo is None
    for frame, compared in ((right.cut, right.cut_vs_photo), (right.leaves, right.leaves_vs_photo)):
        image = frame.result.image
        assert replace(compared, psnr_fitted=None) == score(image, photos["right"])
        assert compared.psnr_fitted == psnr_with_gain(image, photos["right"])
