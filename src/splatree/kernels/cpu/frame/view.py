"""A camera as the compiled kernels take it: the struct View in shared/project.h."""

from typing import NamedTuple

import numpy as np

from splatree.constants import DILATION_MIN_PX2, SIGMA_MAX_PX
from splatree.errors import InputError
from splatree.kernels.reference.square import SquareRule, rule_of
from splatree.maths.slopes import held_slopes
from splatree.scene.view import View
from splatree.shapes import Array, Float64

__all__ = ["PackedView", "pack_square", "pack_view"]


class PackedView(NamedTuple):
    """The numbers of the struct View in shared/project.h, by their names there."""

    rotation: Float64[Array, "3 3"]
    """Of the camera, row by row."""
    center: Float64[Array, "3"]
    """Of the camera in the world."""
    fx: float
    """Focal length along x, px."""
    fy: float
    """The same along y."""
    cx: float
    """Principal point along x, px."""
    cy: float
    """The same along y."""
    width: float
    """Of the image, px."""
    height: float
    """The same along y."""
    near: float
    """Distance of the near plane."""
    slope_min_x: float
    """Least slope x / z of the Jacobian."""
    slope_max_x: float
    """The largest."""
    slope_min_y: float
    """Least slope y / z of the Jacobian."""
    slope_max_y: float
    """The largest."""
    dilation: float
    """Variance added to splats, px²."""
    sigma_max: float
    """Largest scale that is drawn, in units of the distance."""


def pack_view(view: View) -> PackedView:
    """The numbers that the kernels take of a view."""
    camera, dilation_px2 = view.camera, view.dilation_px2
    if camera.lens is not None:
        raise InputError(
            f"camera {camera.name!r}: found a lens, wanted a pinhole: a stage of a frame knows no other; `render` and `trace` "
            "take cameras with a lens"
        )
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    # Not −Rᵀt: the rotation may be off by 1e-4, and then the pixels of far Gaussians would move.
    center = np.linalg.solve(rotation, -translation)
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    return PackedView(
        np.ascontiguousarray(rotation, np.float64),
        np.ascontiguousarray(center, np.float64),
        *(fx, fy, cx, cy),
        *(camera.width, camera.height, camera.near),
        *held_slopes(fx, cx, camera.width),
        *held_slopes(fy, cy, camera.height),
        max(dilation_px2, DILATION_MIN_PX2),
        SIGMA_MAX_PX / max(fx, fy),
    )


def pack_square(view: View) -> SquareRule | None:
    """The rule of the squares; None if the tile rule lists none."""
    return rule_of(view) if view.is_square else None
