"""What a lane of step 1 computes, in whole numbers: Gaussians and views as it takes them, and its splats.

With t = W μ + d the mean as the camera sees it, the rows of the factor M of Σ' = M Mᵀ (docs/explanation/project.md) are

    M_x = f_x / z · ((W_x − t_x/z · W_z) R) S,        M_y = f_y / z · ((W_y − t_y/z · W_z) R) S

The Jacobian has two zeros, and two of its entries are equal up to the focal lengths. Here it costs 6 products in place of the
27 of a full 3 × 3 matrix; with the rotation, the scales and the squares it is 39 in place of 108.

A number with p places stands for n 2⁻ᵖ. Rounding is towards −∞, by leaving bits away. Coordinates are in units u, as in
`rtl.integers`. Scales are 16 bits with an exponent that the three of a Gaussian share.
"""

from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.hardware.rtl.integers import LARGEST
from splatree.maths.slopes import held_slopes
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Int64

__all__ = ["LaneGaussians", "LaneSplats", "LaneView", "lane_gaussians", "lane_view", "project"]

COORDINATE_BITS, QUAT_BITS, SCALE_BITS, EXPONENT_BITS = 24, 16, 16, 6
WEIGHT_BITS, OFFSET_BITS, FOCAL_BITS, GAIN_BITS = 18, 48, 24, 18
QUAT_PLACES, WEIGHT_PLACES, FOCAL_PLACES = 14, 16, 8
SLOPE_BITS, SLOPE_PLACES = 27, 18
"""Of x/z, for the position."""
HELD_BITS, HELD_PLACES = 18, 15
"""Of x/z, for the Jacobian."""
TABLE_BITS, TABLE_PLACES, RECIPROCAL_PLACES = 8, 11, 19
"""Index and places of the table of reciprocals, and the places after one step of Newton."""
PX_BITS, PX_PLACES = 32, 12
"""Of positions, px, and of variances, px²."""
ROW_BITS = 24
"""Of a row of M, px, with `PX_PLACES`: standard deviations of at most 2,048 px."""
VARIANCE_BITS = 40
REACH_BITS, REACH_PLACES = 8, 4
"""Of the squared reach of a splat, in variances."""
K_PLACES = 8 - PX_PLACES
"""K 2^(all exponents) has so many places more than a row."""

RECIPROCALS = np.rint(2**TABLE_PLACES / (1 + (np.arange(2**TABLE_BITS) + 0.5) / 2**TABLE_BITS)).astype(np.int64)
"""1/m for m in [1, 2), by the eight bits behind its leading one."""


@dataclass(frozen=True, eq=False)
class LaneGaussians:
    """Gaussians in the circuit's numbers."""

    centers: Int64[Array, "n 3"]
    """Means in units."""
    quats: Int64[Array, "n 4"]
    """Rotations wxyz of length one."""
    scales: Int64[Array, "n 3"]
    """Standard deviations in units, divided by two to the power of the exponent."""
    exponents: Int64[Array, "n"]
    """Exponents."""


@dataclass(frozen=True, eq=False)
class LaneView:
    """A view in the circuit's numbers."""

    weights: Int64[Array, "3 3"]
    """Rotation of the camera."""
    offsets: Int64[Array, "3"]
    """Its translation in units, `WEIGHT_PLACES`."""
    near: int
    """Least depth in units."""
    focals: Int64[Array, "2"]
    """Focal lengths, px."""
    centers: Int64[Array, "2"]
    """Principal point, px, `PX_PLACES`."""
    size: Int64[Array, "2"]
    """Width and height, px."""
    held: Int64[Array, "2 2"]
    """Least and largest slope of the Jacobian, along x and along y."""
    gains: Int64[Array, "2"]
    """Focal lengths, divided by two to the power of the exponent."""
    exponent: int
    """Exponent."""
    dilation: int
    """Added to both variances, px², `PX_PLACES`."""
    reach: int
    """Squared reach of a splat in variances."""


@dataclass(frozen=True, eq=False)
class LaneSplats:
    """What the lane hands on for each Gaussian."""

    kept: Bool[Array, "n"]
    """Whether it lies in front of the camera and may touch the picture."""
    depths: Int64[Array, "n"]
    """Depths in units, with 8 places."""
    means_px: Int64[Array, "n 2"]
    """Positions, px, `PX_PLACES`."""
    variances: Int64[Array, "n 3"]
    """Σ' as xx, xy, yy, px², `PX_PLACES`."""


def lane_gaussians(gaussians: Gaussians, origin: Array, unit: float) -> LaneGaussians:
    """Quantise Gaussians.

    Args:
        gaussians: n Gaussians.
        origin: world coordinates of the middle of the scene (3).
        unit: world units of one step.

    Raises:
        InputError: a mean lies outside of the coordinates.
    """
    centers = np.rint((gaussians.means.astype(np.float64) - origin) / unit)
    if np.abs(centers).max(initial=0) > LARGEST:
        raise InputError(
            f"rtl: found a mean {np.abs(centers).max():.3g} units from the origin, wanted at most {LARGEST}"
        )
    quats = gaussians.quats.astype(np.float64)
    quats = np.rint(quats / np.linalg.norm(quats, axis=1, keepdims=True) * 2**QUAT_PLACES)
    scales = np.exp(gaussians.log_scales.astype(np.float64)) / unit
    least, most = -(2 ** (EXPONENT_BITS - 1)), 2 ** (EXPONENT_BITS - 1) - 1
    exponents = np.clip(np.floor(np.log2(scales.max(axis=1))) + 1 - SCALE_BITS, least, most)
    scaled = np.minimum(np.rint(scales / 2.0 ** exponents[:, None]), 2**SCALE_BITS - 1)
    return LaneGaussians(*(a.astype(np.int64) for a in (centers, quats, scaled, exponents)))


def lane_view(view: View, origin: Array, unit: float) -> LaneView:
    """Quantise a view.

    Args:
        view: camera and dilation, and down to which opacity splats are drawn.
        origin: world coordinates of the middle of the scene (3).
        unit: world units of one step.

    Raises:
        InputError: the eye is too far away, or the field of view too wide, for the bits of the circuit.
    """
    camera = view.camera
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    offsets = (rotation @ origin + translation) / unit
    if np.abs(offsets).max() >= 2 ** (OFFSET_BITS - WEIGHT_PLACES - 2):
        raise InputError(
            f"rtl: found an eye {np.abs(offsets).max():.3g} units from the scene, wanted less than 2³⁰; move it"
        )
    focals = np.array([camera.K[0, 0], camera.K[1, 1]])
    if focals.max() >= 2 ** (FOCAL_BITS - 1 - FOCAL_PLACES):
        raise InputError(f"rtl: found a focal length of {focals.max():.0f} px, wanted less than 32768")
    held = _held(camera)
    exponent = int(np.floor(np.log2(focals.max()))) + 1 - GAIN_BITS
    gains = np.minimum(np.rint(focals / 2.0**exponent), 2**GAIN_BITS - 1)
    return LaneView(
        weights=_whole(rotation, WEIGHT_PLACES),
        offsets=_whole(offsets, WEIGHT_PLACES),
        near=int(np.ceil(camera.near / unit)),
        focals=_whole(focals, FOCAL_PLACES),
        centers=_whole(camera.K[:2, 2], PX_PLACES),
        size=np.array([camera.width, camera.height], np.int64),
        held=_whole(held, HELD_PLACES),
        gains=gains.astype(np.int64),
        exponent=exponent,
        dilation=int(np.rint(view.dilation_px2 * 2**PX_PLACES)),
        reach=int(np.ceil(2 * np.log(1 / view.pixel_threshold) * 2**REACH_PLACES)),
    )


def project(gaussians: LaneGaussians, view: LaneView) -> LaneSplats:
    """What the circuit computes, without a circuit."""
    # The mean as the camera sees it, and 1/z = r 2^-lift: r by a table and a step of Newton.
    t = gaussians.centers @ view.weights.T + view.offsets  # [n 3]
    z = t[:, 2]
    in_front = z > view.near << WEIGHT_PLACES
    top = np.frexp(np.maximum(z, 1).astype(np.float64))[1].astype(np.int64) - 1  # z < 2^53: exact
    lift = top - 23
    mantissa = _shifted(np.maximum(z, 1), -lift)  # [2^23, 2^24)
    guess = RECIPROCALS[(mantissa >> 15) & 255]
    error = (1 << 34) - mantissa * guess >> 14  # 20 places, |error| < 2^-8
    reciprocal = (guess << 8) + (guess * error >> 12)

    # Position.
    lifted = _held_in(_shifted(t[:, :2], -lift[:, None]), 32)
    slopes = _held_in(lifted * reciprocal[:, None] >> 24, SLOPE_BITS)
    places = SLOPE_PLACES + FOCAL_PLACES - PX_PLACES
    means_px = _held_in((slopes * view.focals >> places) + view.centers, PX_BITS)

    # Rows of M: the Jacobian on the camera's axes, the rotation, the scales, and the focal length over z.
    held = np.clip(slopes >> SLOPE_PLACES - HELD_PLACES, view.held[:, 0], view.held[:, 1])
    axes = view.weights[:2] - (held[:, :, None] * view.weights[2] >> HELD_PLACES)  # [n 2 3]
    turned = np.einsum("nij,njk->nik", axes, _rotation(gaussians.quats)) >> WEIGHT_PLACES
    scaled = turned * gaussians.scales[:, None, :] >> 14
    gains = view.gains * reciprocal[:, None] >> 20
    K = scaled * gains[:, :, None]
    rows = _held_in(_shifted(K, (gaussians.exponents + view.exponent - lift - K_PLACES)[:, None, None]), ROW_BITS)

    # Variances, and whether the picture is in reach.
    pairs = ((0, 0), (0, 1), (1, 1))
    variances = np.stack([(rows[:, i] * rows[:, j]).sum(axis=1) >> PX_PLACES for i, j in pairs], axis=1)
    variances += np.array([1, 0, 1]) * view.dilation
    kept = in_front & _in_reach(means_px, variances[:, [0, 2]], view)
    return LaneSplats(kept, z >> 8, means_px, variances)


def _in_reach(means_px: Array, variances: Array, view: LaneView) -> Bool[Array, "n"]:
    """Whether the ellipse may touch the picture: distances are rounded inwards, variances outwards."""
    beyond = np.maximum(np.maximum(-means_px, means_px - (view.size << PX_PLACES)) >> 8, 0)  # 4 places
    beyond = np.maximum(beyond - 16, 0)  # a pixel less
    return np.asarray(np.all(beyond**2 << REACH_PLACES <= view.reach * ((variances >> 4) + 16), axis=1))


def _rotation(quats: Array) -> Int64[Array, "n 3 3"]:
    w, x, y, z = quats.T
    xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    places = 2 * QUAT_PLACES - 1 - WEIGHT_PLACES
    one = 1 << WEIGHT_PLACES
    rows = [
        [one - (yy + zz >> places), xy - wz >> places, xz + wy >> places],
        [xy + wz >> places, one - (xx + zz >> places), yz - wx >> places],
        [xz - wy >> places, yz + wx >> places, one - (xx + yy >> places)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _held(camera: Camera) -> Array:
    sizes = (camera.width, camera.height)
    held = np.array([held_slopes(camera.K[i, i], camera.K[i, 2], sizes[i]) for i in range(2)])
    if np.abs(held).max() >= 2 ** (HELD_BITS - 1 - HELD_PLACES):
        raise InputError(f"rtl: found slopes of {np.abs(held).max():.2f} in the picture, wanted less than 4")
    return held


def _whole(values: Array, places: int) -> Int64[Array, "..."]:
    return np.asarray(np.rint(np.asarray(values) * 2.0**places), np.int64)


def _shifted(values: Array, left: Array) -> Int64[Array, "..."]:
    """To the left by so many places, 0 to 63, held within 63 bits; to the right where the number is negative."""
    left = np.clip(left, -62, 62)
    up = np.maximum(left, 0)
    largest = np.int64(1 << 62) >> up
    return np.where(left < 0, values >> np.maximum(-left, 0), np.clip(values, -largest, largest - 1) << up)


def _held_in(values: Array, bits: int) -> Int64[Array, "..."]:
    return np.asarray(np.clip(values, -(1 << bits - 1), (1 << bits - 1) - 1))
