"""Pictures through a lens from flat ones, and flat ones from pictures through a lens.

Gaussians are projected by a pinhole. A camera with a lens is therefore drawn by a pinhole at the same place that sees all that
the camera sees (`covering_pinhole`), and the picture is bent (`bend`). Photographs are straightened the other way: to the
largest upright rectangle that the photograph fills (`filled_pinhole`, `straighten`). Where the content is smooth over a pixel
both are exact; each resamples the picture once, linearly between four pixels, which blurs detail of the size of a pixel.

Cost: a map of the picture, kept for the cameras of one lens, and four look-ups a pixel.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from splatree.errors import InputError
from splatree.scene.cameras import Camera
from splatree.scene.lens import ANGLE_MAX, Lens
from splatree.shapes import Array, Float32, Float64

__all__ = ["bend", "covering_pinhole", "filled_pinhole", "straighten"]

_STRETCH_MAX = 2.0
"""A pinhole gets at most this many times the pixels of the lens along a side, where the lens magnifies off its axis."""

_SLOPE_MAX = math.tan(math.radians(60))
"""Photographs are straightened to at most 120° across: beyond it one pixel becomes many, and there is little to compare."""

_Frame = tuple[Lens, tuple[float, float, float, float], int, int]  # lens, fx fy cx cy, width, height


def covering_pinhole(camera: Camera) -> Camera:
    """The pinhole at the place of a camera with a lens that sees all that the camera shows, at its resolution or better.

    Raises:
        InputError: the lens shows directions that no flat picture holds.
    """
    slopes = _slopes_of_pixels(_frame_of(camera))
    if not np.isfinite(slopes).all():
        share = float(np.isnan(slopes[..., 0]).mean())
        raise InputError(
            f"camera {camera.name!r}: its lens shows directions of more than {math.degrees(ANGLE_MAX):.0f}° from its axis, or "
            f"folds back, in {share:.1%} of its {camera.width} × {camera.height} px, and a flat picture cannot hold them; "
            "crop the camera, or undistort its pictures first"
        )
    magnified = max(_largest_step(np.diff(slopes, axis=axis), camera.K[1 - axis, 1 - axis]) for axis in (0, 1))
    stretch = min(max(1.0, magnified), _STRETCH_MAX)
    low, high = slopes.min(axis=(0, 1)), slopes.max(axis=(0, 1))
    return _pinhole(camera, low, high, stretch * np.diag(camera.K)[:2], margin_px=2)


def filled_pinhole(camera: Camera) -> Camera:
    """The pinhole at the place of a camera with a lens whose whole picture the camera shows, at the resolution of its middle.

    Raises:
        InputError: nothing is left.
    """
    lens = camera.lens
    assert lens is not None
    low, high = _filled_box(lens, _slopes_of_pixels(_frame_of(camera)))
    if not ((low < 0).all() and (high > 0).all()):
        raise InputError(f"camera {camera.name!r}: its lens leaves no upright rectangle round its axis to compare with")
    return _pinhole(camera, low, high, np.diag(camera.K)[:2], margin_px=0)


def bend(image: Float32[Array, "h w …"], pinhole: Camera, camera: Camera) -> Float32[Array, "h w …"]:
    """What a camera with a lens shows, from the picture of its covering pinhole."""
    slopes = _slopes_of_pixels(_frame_of(camera))
    return _sampled(image, slopes * np.diag(pinhole.K)[:2] + pinhole.K[:2, 2])


def straighten(photo: Float32[Array, "h w …"], camera: Camera, pinhole: Camera) -> Float32[Array, "h w …"]:
    """What a pinhole at the place of a camera with a lens shows, from the camera's photograph."""
    lens = camera.lens
    assert lens is not None
    slopes = (_pixel_centres(pinhole.width, pinhole.height) - pinhole.K[:2, 2]) / np.diag(pinhole.K)[:2]
    return _sampled(photo, lens.bent(slopes) * np.diag(camera.K)[:2] + camera.K[:2, 2])


def _frame_of(camera: Camera) -> _Frame:
    assert camera.lens is not None
    fx, fy, cx, cy = (float(camera.K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return camera.lens, (fx, fy, cx, cy), camera.width, camera.height


@lru_cache(maxsize=2)
def _slopes_of_pixels(frame: _Frame) -> Float64[Array, "h w 2"]:
    """The direction that each pixel shows."""
    lens, (fx, fy, cx, cy), width, height = frame
    slopes = lens.straight((_pixel_centres(width, height) - (cx, cy)) / (fx, fy))
    slopes.flags.writeable = False
    return slopes


def _pixel_centres(width: int, height: int) -> Float64[Array, "h w 2"]:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def _largest_step(steps: Array, focal: float) -> float:
    """How many pixels of the lens a pixel of a pinhole of the same focal length takes at most."""
    least = float(np.linalg.norm(steps, axis=-1).min(initial=np.inf)) * focal
    return 1 / least if 0 < least < math.inf else 1.0


def _filled_box(lens: Lens, slopes: Float64[Array, "h w 2"]) -> tuple[Array, Array]:
    """Corners of a box of slopes round the axis that lies inside the picture: its sides are the innermost of each border.

    Borders that show directions beyond what is known lie outside of the largest box anyway.
    """
    left, top, right, bottom = slopes[:, 0, 0], slopes[0, :, 1], slopes[:, -1, 0], slopes[-1, :, 1]
    low = np.array([np.fmax.reduce(border, initial=-_SLOPE_MAX) for border in (left, top)])
    high = np.array([np.fmin.reduce(border, initial=_SLOPE_MAX) for border in (right, bottom)])
    for _ in range(100):  # where the lens folds back inside of the corners, a smaller box of the same shape
        corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
        if np.isfinite(lens.straight(lens.bent(corners))).all():
            break
        low, high = 0.97 * low, 0.97 * high
    return low, high


def _pinhole(camera: Camera, low: Array, high: Array, focal: Array, *, margin_px: int) -> Camera:
    """The pinhole whose pixels' centres span the slopes from ``low`` to ``high``, and a margin."""
    size = np.maximum((high - low) * focal, 0)
    width, height = (int(s) for s in (np.ceil(size) + 1 + 2 * margin_px if margin_px else np.floor(size) + 1))
    cx, cy = 0.5 + margin_px - low * focal
    K = np.array([[focal[0], 0, cx], [0, focal[1], cy], [0, 0, 1]])
    return replace(camera, K=K, width=width, height=height, lens=None)


def _sampled(image: Array, places: Float64[Array, "h w 2"]) -> Array:
    """The picture at places in px, linearly between the centres of pixels; beyond its border the border."""
    height, width = image.shape[:2]
    x = np.clip(places[..., 0] - 0.5, 0, width - 1)
    y = np.clip(places[..., 1] - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(np.int32), max(width - 2, 0)), np.minimum(y.astype(np.int32), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    channels = [1] * (image.ndim - 2)
    across, down = (w.astype(np.float32).reshape(*w.shape, *channels) for w in (x - left, y - top))
    upper = image[top, left] * (1 - across) + image[top, right] * across
    lower = image[below, left] * (1 - across) + image[below, right] * across
    return np.asarray(upper * (1 - down) + lower * down, np.float32)
