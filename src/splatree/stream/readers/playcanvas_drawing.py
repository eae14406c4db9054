"""How PlayCanvas draws Gaussians in WebGL: splats are thinner than the scene was trained with, and the smallest are left out.

The engine (2.22.6 and 2.23.3, gsplatCornerVS and gsplatPS) measures in half pixels: focal lengths are twice those in pixels, so
variances are four times those in px². It widens them by 0.3 in these units. So its dilation d is 0.075 px², a quarter of the
usual one. A splat of variance λ, px², along its longer axis is left out if the side of its quad, 2 √(2 (4 λ + 4 d)) px, is less
than ``minPixelSize``, 2. With the engine's d these are splats of a standard deviation of less than 0.22 px; from d = 0.125 px² on
none is left out. The opacity at A = r² / (8 σ²) is

    α (e^(−4 A) − e^(−4)) / (1 − e^(−4)),

0 from A = 1 on. That is drawn here as a Gaussian of the same integral, 1 − 4 / (e⁴ − 1) = 0.925 times the area. The engine keeps
scales in 255 steps of their logarithm. It does not know the mode `antialiased`. The least contribution,
``minContribution``, is a rule of WebGPU alone.

In a browser, pictures of 384 × 216 px of a piece of a city are at 41 to 46 dB against these, and at 22 to 37 dB against the
library's.
"""

import dataclasses
import math

import numpy as np

from splatree.constants import DILATION_PX2
from splatree.maths.rotations import matrices_from_quats
from splatree.render.pipeline import render
from splatree.scene.cameras import Camera
from splatree.scene.frame import RenderResult
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, Float64

__all__ = ["ENGINE_DILATION_PX2", "draw_playcanvas"]

ENGINE_DILATION_PX2 = DILATION_PX2 / 4
"""What the engine adds to the variances of splats, px²."""

_LEAST_VARIANCE_PX2 = 1 / 8
"""λ + d of a splat whose quad is two pixels wide."""

_RIM_AREA = 1 - 4 / math.expm1(4)
"""Integral of a splat that falls to 0 at A = 1, for that of a whole Gaussian."""

_LOG_SCALE_MIN, _LOG_SCALE_STEP = -12.0, 21 / 255
"""Steps of scales in the engine's buffer of all splats (containerCompactWrite)."""


_ROWS_AT_ONCE = 2**18
"""Of Gaussians that are projected: 300 bytes each, so 80 MB."""


def draw_playcanvas(gaussians: Gaussians, camera: Camera, *, dilation_px2: float = ENGINE_DILATION_PX2) -> RenderResult:
    """The picture of Gaussians as decoded; the page of `serve` sets ``dilation_px2`` to the usual one."""
    steps = np.clip(np.round((gaussians.log_scales - _LOG_SCALE_MIN) / _LOG_SCALE_STEP), 1, 255)
    log_scales = (steps * _LOG_SCALE_STEP + _LOG_SCALE_MIN).astype(np.float32)
    stored = dataclasses.replace(gaussians, log_scales=log_scales)
    drawn = stored.take(np.flatnonzero(_largest_variances(stored, camera) + dilation_px2 >= _LEAST_VARIANCE_PX2))
    drawn = dataclasses.replace(drawn, log_scales=drawn.log_scales + np.float32(math.log(_RIM_AREA) / 2))
    options = RenderOptions(mode="classic", dilation_px2=dilation_px2 * _RIM_AREA)
    return render(Scene.flat(drawn), camera, options, select=SelectOptions(pixel_error=0))


def _largest_variances(g: Gaussians, camera: Camera) -> Float64[Array, "n"]:
    """λ of each Gaussian: the larger eigenvalue of its covariance on the image, px²."""
    found = np.empty(len(g))
    for first in range(0, len(g), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        found[rows] = _largest_of(g.means[rows], g.quats[rows], g.log_scales[rows], camera)
    return found


def _largest_of(
    means: Float32[Array, "n 3"], quats: Float32[Array, "n 4"], log_scales: Float32[Array, "n 3"], camera: Camera
) -> Float64[Array, "n"]:
    W, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    points = means.astype(np.float64) @ W.T + t
    z = np.maximum(points[:, 2], camera.near)
    axes = (W @ matrices_from_quats(quats)) * np.exp(log_scales.astype(np.float64))[:, None, :]  # [n 3 3]
    slopes = points[:, :2] / z[:, None]
    focal = np.array([camera.K[0, 0], camera.K[1, 1]])
    M = (axes[:, :2] - slopes[:, :, None] * axes[:, 2:]) * (focal / z[:, None])[:, :, None]  # [n 2 3]
    xx, yy, xy = (np.sum(M[:, i] * M[:, j], axis=1) for i, j in ((0, 0), (1, 1), (0, 1)))
    return np.asarray((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy))
