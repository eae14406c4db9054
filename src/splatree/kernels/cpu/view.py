"""A camera as the compiled kernels take it: the struct View in shared/project.h."""

import numpy as np

from splatree.constants import DILATION_MIN_PX2, FRUSTUM_CLAMP, SIGMA_MAX_PX
from splatree.kernels.reference.square import rule_of
from splatree.scene.cameras import Camera
from splatree.scene.options import ResolvedOptions
from splatree.shapes import Array, Float64

__all__ = ["pack_square", "pack_view"]


def pack_view(camera: Camera, dilation_px2: float) -> Float64[Array, "25"]:
    """The numbers of the struct View, in its order."""
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    # Not −Rᵀt: the rotation may be off by 1e-4, and then the pixels of far Gaussians would move.
    center = np.linalg.solve(rotation, -translation)
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    before, after = np.array([cx / fx, cy / fy]), np.array([(camera.width - cx) / fx, (camera.height - cy) / fy])
    margin = (FRUSTUM_CLAMP - 1.0) * (before + after) / 2
    (min_x, min_y), (max_x, max_y) = -before - margin, after + margin
    size = [camera.width, camera.height, camera.near]
    slopes = [min_x, max_x, min_y, max_y]
    limits = [max(dilation_px2, DILATION_MIN_PX2), SIGMA_MAX_PX / max(fx, fy)]
    return np.array([*rotation.ravel(), *center, fx, fy, cx, cy, *size, *slopes, *limits], np.float64)


def pack_square(options: ResolvedOptions) -> Float64[Array, "5"] | None:
    """The numbers of the struct Square, in its order; None if the extent is no square."""
    if not options.is_square:
        return None
    return np.array(rule_of(options), np.float64)
