"""FLIP: how visible the differences between two pictures are to somebody who alternates between them (Andersson 2020).

Two pipelines meet in one error a pixel, 0 (equal) to 1 (as different as can be):

- colour (§5.1): both pictures, in opponent colours, are blurred by the contrast sensitivity of the eye at a distance; what is
  left is compared in Lab, with chroma weighted by lightness (Hunt) and a distance that adds lightness and chroma (HyAB);
- features (§5.2): edges and points, derivatives of a Gaussian, that are in one picture and not in the other.

::

    error = colour ^ (1 − feature)

Pictures are sRGB, 0 to 1. The eye sees `PIXELS_PER_DEGREE`: it is 0.7 m away from a screen that is 0.7 m and 3,840 px wide.
The mean of the errors is the number that is reported.

All filters are sums of products of one-dimensional ones, at edges with the outermost pixels repeated: about 1 s a megapixel.
"""

from typing import Final

import numpy as np

from splatree.errors import InputError
from splatree.metrics.psnr import comparable
from splatree.scene.arguments import checked
from splatree.shapes import Array, Float32, Float64

__all__ = ["PIXELS_PER_DEGREE", "flip", "flip_map"]

PIXELS_PER_DEGREE: Final = 0.7 * (3840 / 0.7) * np.pi / 180
"""Pixels in a degree of the field of view: distance · (pixels / width) · π / 180 (Andersson 2020, §5)."""

CSF: Final = {
    "A": ((1.0, 0.0047),),
    "RG": ((1.0, 0.0053),),
    "BY": ((34.1, 0.04), (13.5, 0.025)),
}
"""Weight a and width b, degrees², of the Gaussians of each opponent colour's contrast sensitivity (Andersson 2020, Table 1)."""

Q_C, P_C, P_T = 0.7, 0.4, 0.95
"""Exponent of the colour difference, and the share P_C of its largest value that is mapped to P_T (§5.1.4)."""

FEATURE_WIDTH: Final = 0.082
"""Width of the feature detectors, degrees (§5.2)."""

Q_F: Final = 0.5
"""Exponent of the feature difference (§5.3)."""

XYZ_FROM_RGB: Final = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
"""Linear sRGB to XYZ, D65 (IEC 61966-2-1 in the fractions of the code of Andersson 2020)."""

WHITE: Final = XYZ_FROM_RGB.sum(axis=1)
"""XYZ of white."""


@checked
def flip(image: Float32[Array, "h w 3"], reference: Float32[Array, "h w 3"]) -> float:
    """Mean FLIP error of two sRGB pictures: how different they look when they are shown in turn.

    Args:
        image: a picture, (h w 3), colours 0 to 1; values outside are clipped.
        reference: the picture to compare it with, of the same shape.

    Returns:
        The mean over the pixels: 0 for equal pictures, at most 1.

    Raises:
        InputError: the pictures differ in shape, are no RGB, or hold NaN or infinity.

    Source:
        Andersson 2020, "FLIP: A Difference Evaluator for Alternating Images".

    Example:
        >>> grey = np.full((64, 64, 3), 0.5, np.float32)
        >>> st.flip(grey, grey)
        0.0
    """
    return float(flip_map(image, reference).mean(dtype=np.float64))


def flip_map(image: Float32[Array, "h w 3"], reference: Float32[Array, "h w 3"]) -> Float32[Array, "h w"]:
    """Return the FLIP error of each pixel; arguments and errors as those of `flip`."""
    a, b = comparable(image, reference)
    if a.ndim != 3 or a.shape[2] != 3:
        raise InputError(f"flip: found shape {a.shape}, wanted RGB pictures (h w 3)")
    opponents = [_opponent(_linear(np.clip(x, 0, 1))) for x in (a, b)]
    color = _color_difference(*opponents)
    feature = _feature_difference(*(((x[0] + 16) / 116) for x in opponents))
    return np.asarray(color ** (1 - feature), np.float32)


def _linear(srgb: Array) -> Array:
    """Linear light, planes first."""
    planes = np.moveaxis(srgb, -1, 0)
    return np.asarray(
        np.where(planes > 0.04045, ((np.maximum(planes, 0.04045) + 0.055) / 1.055) ** 2.4, planes / 12.92)
    )


def _opponent(linear: Array) -> Float64[Array, "3 h w"]:
    """YCxCz: lightness, red-green, blue-yellow."""
    x, y, z = np.tensordot(XYZ_FROM_RGB / WHITE[:, None], linear, axes=1)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def _color_difference(a: Array, b: Array) -> Float64[Array, "h w"]:
    difference = _hyab(_perceived(a), _perceived(b)) ** Q_C
    green, blue = (_hunt(_lab(np.array(c, float)[:, None, None])) for c in ((0, 1, 0), (0, 0, 1)))
    largest = float(_hyab(green, blue)[0, 0]) ** Q_C
    bend = P_C * largest
    above = P_T + (difference - bend) / (largest - bend) * (1 - P_T)
    return np.asarray(np.where(difference < bend, P_T / bend * difference, above))


def _perceived(opponent: Array) -> Array:
    """What the eye keeps of a picture, in Lab with Hunt's weights."""
    blurred = [_blurred(plane, CSF[name]) for plane, name in zip(opponent, CSF, strict=True)]
    y = (blurred[0] + 16) / 116
    xyz = np.stack([y + blurred[1] / 500, y, y - blurred[2] / 200]) * WHITE[:, None, None]
    return _hunt(_lab(np.clip(np.tensordot(np.linalg.inv(XYZ_FROM_RGB), xyz, axes=1), 0, 1)))


def _blurred(plane: Array, gaussians: tuple[tuple[float, float], ...]) -> Array:
    radius = int(np.ceil(3 * np.sqrt(max(b for *_, b in CSF["BY"]) / (2 * np.pi**2)) * PIXELS_PER_DEGREE))
    at = np.arange(-radius, radius + 1) / PIXELS_PER_DEGREE
    total, mass = np.zeros_like(plane), 0.0
    for a, b in gaussians:
        taps = np.exp(-(np.pi**2) / b * at * at)
        height = a * np.sqrt(np.pi / b)
        total += height * _filtered(plane, taps, taps)
        mass += height * float(taps.sum()) ** 2
    return np.asarray(total / mass)


def _lab(linear: Array) -> Array:
    t = np.tensordot(XYZ_FROM_RGB / WHITE[:, None], linear, axes=1)
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def _hunt(lab: Array) -> Array:
    """Chroma grows with lightness."""
    return np.stack([lab[0], 0.01 * lab[0] * lab[1], 0.01 * lab[0] * lab[2]])


def _hyab(a: Array, b: Array) -> Array:
    return np.asarray(np.abs(a[0] - b[0]) + np.hypot(a[1] - b[1], a[2] - b[2]))


def _feature_difference(a: Array, b: Array) -> Float64[Array, "h w"]:
    deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE
    at = np.arange(-int(np.ceil(3 * deviation)), int(np.ceil(3 * deviation)) + 1)
    bell = np.exp(-(at * at) / (2 * deviation**2))
    edge, point = (_balanced(taps) for taps in (-at * bell, (at * at / deviation**2 - 1) * bell))
    bell = bell / bell.sum()
    found = [[np.hypot(_filtered(x, taps, bell), _filtered(x, bell, taps)) for taps in (edge, point)] for x in (a, b)]
    largest = np.maximum(*(np.abs(found[0][i] - found[1][i]) for i in (0, 1)))
    return np.asarray((largest / np.sqrt(2)) ** Q_F)


def _balanced(taps: Array) -> Array:
    """Positive taps add up to 1, negative ones to −1."""
    return np.asarray(np.where(taps > 0, taps / taps[taps > 0].sum(), taps / -taps[taps < 0].sum()))


def _filtered(plane: Array, across: Array, down: Array) -> Array:
    """Correlation with the product of two filters of one odd length."""
    radius = len(across) // 2
    padded = np.pad(plane, radius, mode="edge")
    height, width = plane.shape
    rows = sum(tap * padded[:, i : i + width] for i, tap in enumerate(across))
    return np.asarray(sum(tap * rows[i : i + height] for i, tap in enumerate(down)))
