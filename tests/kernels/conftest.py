"""Scenes that are hard for a renderer."""

from collections.abc import Callable

import numpy as np
import pytest

import splatree as st

from ..scenes import camera, gaussians


def needles() -> st.Gaussians:
    """Splats of an aspect of 10,000 to 1, up to some thousand pixels long, in all directions."""
    g = gaussians(60, 2)
    log_scales = np.tile(np.log(np.array([20.0, 2e-3, 2e-3], np.float32)), (60, 1))
    return st.Gaussians(g.means, g.quats, log_scales, g.logit_opacities, g.sh)


def moved(g: st.Gaussians, offset: float) -> st.Gaussians:
    """The cloud far from the origin, on a grid that float32 holds there."""
    means = np.float32(offset) + np.round(g.means * 64) / 64
    return st.Gaussians(means.astype(np.float32), g.quats, g.log_scales, g.logit_opacities, g.sh)


def far_camera(offset: float) -> st.Camera:
    """The camera of a cloud that was moved."""
    eye, target = np.array([0.3, -0.4, -4.0]) + offset, np.full(3, offset)
    return st.Camera.look_at(eye, target, width=52, height=37)


def absurd() -> st.Gaussians:
    """Rows that a reader would refuse, among good ones: they must not crash, nor spoil the others."""
    g = gaussians(40, 7)
    g.means[0] = np.nan
    g.means[1] = np.inf
    g.log_scales[2] = 80
    g.log_scales[3] = -200
    g.quats[4] = 0
    g.quats[5] = 1e30
    g.quats[6] = 1e-30
    g.logit_opacities[7] = np.inf
    g.logit_opacities[8] = -np.inf
    g.means[9] = (0.3, -0.4, -4.0)  # at the eye
    g.means[10] = 1e30
    return g


SCENES: dict[str, Callable[[], tuple[st.Gaussians, st.Camera]]] = {
    "cloud": lambda: (gaussians(300, 1, degree=3), camera()),
    "needles": lambda: (needles(), camera()),
    "huge": lambda: (gaussians(40, 3, log_scales=(1, 4)), camera()),
    "inside": lambda: (gaussians(80, 4, log_scales=(-2, 1), spread=2), camera(distance=0.1)),
    "close": lambda: (gaussians(80, 4, log_scales=(-6, -2), spread=0.5), camera(distance=0.3, near=1e-3)),
    "sub-pixel": lambda: (gaussians(300, 5, log_scales=(-12, -8)), camera()),
    "off-centre": lambda: (gaussians(200, 6), camera(shift_x=70.0, shift_y=-31.5)),
    "one pixel": lambda: (gaussians(100, 8), camera(1, 1)),
    "one column": lambda: (gaussians(100, 8), camera(1, 33)),
    "whole tiles": lambda: (gaussians(100, 9), camera(48, 32)),
    "one Gaussian": lambda: (gaussians(1, 10, log_scales=(-2, -1), spread=0.1), camera()),
    "nothing": lambda: (st.Gaussians.empty(1), camera()),
    "behind": lambda: (gaussians(20, 11), camera(distance=-9.0)),
    "map coordinates": lambda: (moved(gaussians(200, 12), 100_000.0), far_camera(100_000.0)),
}
"""Hard scenes by name; each with a camera."""


@pytest.fixture(params=SCENES)
def view(request: pytest.FixtureRequest) -> tuple[st.Scene, st.Camera]:
    """Each hard scene in turn."""
    g, seen_by = SCENES[request.param]()
    return st.Scene.flat(g), seen_by
