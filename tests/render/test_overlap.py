"""Hints at cameras and scenes that are in other coordinates."""

import numpy as np
import pytest

import splatree as st
from splatree.render.overlap import overlap_hint, place_hint

from ..scenes import random_gaussians


def spot(x, y, z):
    """A scene of a few small Gaussians about one place."""
    g = random_gaussians(20)
    g.means[:] = np.float32([x, y, z]) + np.float32(1e-5) * g.means
    g.log_scales[:] = -9
    return st.Scene.flat(g)


WIDE = st.Camera(np.eye(4), np.array([[50.0, 0, 100], [0, 80.0, 40], [0, 0, 1]]), 200, 80, name="wide")
"""Its picture holds x / z from −2 to 2 and y / z from −½ to ½; a tenth of the picture around it counts as seen: 2.4 and 0.6."""


@pytest.mark.parametrize(
    ("place", "seen"),
    [
        ((0, 0, 1), True),
        ((2.3, 0, 1), True),
        ((-4.6, 0, 2), True),
        ((2.5, 0, 1), False),
        ((-5.0, 0, 2), False),
        ((0, 0.58, 1), True),
        ((0, -1.16, 2), True),
        ((0, 0.62, 1), False),
        ((0, -1.24, 2), False),
        ((0, 0, -1), False),
    ],
)
def test_a_scene_in_or_near_the_picture_is_seen(place, seen):
    assert (overlap_hint(spot(*place), [WIDE]) is None) == seen


def test_one_camera_that_sees_the_scene_is_enough():
    turned = st.Camera(np.diag([-1.0, 1, -1, 1]), WIDE.K, 200, 80, name="turned")
    scene = spot(0, 0, 30)
    assert overlap_hint(scene, [turned, turned, WIDE]) is None
    hint = overlap_hint(scene, [turned, turned])
    assert hint is not None and "none of the 2 cameras sees the scene: they are 30 and more from its middle" in hint
    assert overlap_hint(scene, []) is None
    assert overlap_hint(st.Scene.flat(st.Gaussians.empty()), [turned]) is None


@pytest.mark.parametrize(
    ("move", "scale", "told"),
    [((0, 0, 0), 1, False), ((5.5, 0, 0), 1, False), ((7, 0, 0), 1, True), ((0, 0, 0), 1.4, False), ((0, 0, 0), 0.6, True),
     ((0, 0, 0), 1.6, True)],
)  # fmt: skip
def test_scenes_of_one_place_lie_within_a_quarter_of_a_radius(move, scale, told):
    """The radius is 24.8."""
    g = random_gaussians(2000)
    reference = st.Scene.flat(g)
    scene = st.edit(reference, st.EditOptions(scale=scale, translate=move))
    hint = place_hint(scene, reference)
    assert (hint is not None) == told, hint
    assert place_hint(st.Scene.flat(st.Gaussians.empty()), reference) is None
