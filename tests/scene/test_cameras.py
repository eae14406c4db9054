from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree import Camera, InputError


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    camera = Camera.look_at([3.0, -2.0, 1.0], [0.0, 0.5, 4.0], width=200, height=100)
    target = camera.camera_from_world @ [0.0, 0.5, 4.0, 1.0]
    assert np.allclose(target[:2], 0, atol=1e-12)
    assert target[2] > 0
    above = camera.camera_from_world @ [0.0, -0.5, 4.0, 1.0]  # y is down in the world
    assert above[1] < 0
    assert np.allclose(camera.position, [3.0, -2.0, 1.0])


@pytest.mark.parametrize("direction", [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
def test_look_at_along_up_is_a_valid_camera(direction):
    camera = Camera.look_at([0.0, 0.0, 0.0], direction)
    assert (camera.camera_from_world @ [*direction, 1.0])[2] == pytest.approx(1.0)


def test_scaled_camera_sees_the_same_field_of_view():
    camera = Camera.look_at([0.0, 0.0, -5.0], [0.0, 0.0, 0.0], width=640, height=480)
    half = camera.scaled(0.5)
    assert (half.width, half.height) == (320, 240)
    assert np.allclose(half.K[:2], camera.K[:2] / 2)


def test_a_camera_that_cannot_be_is_refused():
    camera = Camera.look_at([0.0, 0.0, -5.0], [0.0, 0.0, 0.0])
    mirrored = camera.camera_from_world.copy()
    mirrored[0] *= -1
    for wrong in (
        {"width": 0},
        {"height": 36.5},
        {"near": 0.0},
        {"near": np.nan},
        {"K": -camera.K},
        {"K": camera.K * np.nan},
        {"camera_from_world": mirrored},
        {"camera_from_world": np.zeros((4, 4))},
    ):
        with pytest.raises(InputError):
            replace(camera, **wrong)
    with pytest.raises(InputError, match="same point"):
        Camera.look_at([1.0, 1.0, 1.0], [1.0, 1.0, 1.0])
    for wrong in ([np.nan, 1.0, 1.0], [1.0, 1.0], [np.inf, 0.0, 0.0]):
        with pytest.raises(InputError, match=r"found position .* wanted x y z of each, finite"):
            Camera.look_at(wrong, [0.0, 0.0, 0.0])


@pytest.mark.parametrize("factor", [0, -1, float("nan"), float("inf"), 1e308, 1e12])
def test_a_scale_that_leaves_no_picture_is_refused(factor):
    camera = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=16, height=16)
    with pytest.raises(
        st.InputError, match=r"scale: found .*, wanted more than 0 and sides of at most 2,147,483,647 px"
    ):
        camera.scaled(factor)
    assert camera.scaled(1e-9).width == 1
