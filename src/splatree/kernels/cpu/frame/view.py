"""A camera as the compiled kernels take it: the struct View in shared/project.h."""

import numpy as np

from splatree.constants import DILATION_MIN_PX2, FRUSTUM_CLAMP, SIGMA_MAX_PX
from splatree.errors import InputError
from splatree.kernels.reference.square import rule_of
from splatree.scene.view import View
from splatree.shapes import Array, Float64

__all__ = ["pack_square", "pack_view"]


def pack_view(view: View) -> Float64[Array, "25"]:
    """The numbers of the struct View, in its order."""
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
    size = [camera.width, camera.height, camera.near]
    slopes = [*_slopes(fx, cx, camera.width), *_slopes(fy, cy, camera.height)]
    limits = [max(dilation_px2, DILATION_MIN_PX2), SIGMA_MAX_PX / max(fx, fy)]
    return np.array([*rotation.ravel().tolist(), *center.tolist(), fx, fy, cx, cy, *size, *slopes, *limits], np.float64)


def _slopes(focal: float, centre: float, size: int) -> tuple[float, float]:
    """The least and the largest slope x / z to which the Jacobian is clamped."""
    before, after = centre / focal, (size - centre) / focal
    margin = (FRUSTUM_CLAMP - 1.0) * (before + after) / 2
    return -before - margin, after + margin


def pack_square(view: View) -> Float64[Array, "5"] | None:
    """The numbers of the struct Square, in its order; None if the tile rule lists no square."""
    if not view.is_square:
        return None
    return np.array(rule_of(view), np.float64)
