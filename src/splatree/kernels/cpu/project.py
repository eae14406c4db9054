"""Project Gaussians to splats: glue over project.cpp and order.cpp; kernels/reference/project.py is the definition."""

import numpy as np

from splatree.constants import DILATION_MIN_PX2, FRUSTUM_CLAMP, SIGMA_MAX_PX
from splatree.kernels.cpu import _core
from splatree.scene.cameras import Camera
from splatree.scene.frame import Splats
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import ResolvedOptions
from splatree.shapes import Array, Float32, Float64, Int32, UInt32

__all__ = ["project"]


def project(
    gaussians: Gaussians,
    ids: UInt32[Array, "n"] | None,
    rows: Int32[Array, "v"],
    camera: Camera,
    options: ResolvedOptions,
    *,
    threads: int = 0,
) -> Splats:
    """Splats of the rows that touch the image."""
    out_rows = np.empty(len(rows), np.int32)
    records = _empty_records(len(rows))
    num_splats = _core.project_rows(
        gaussians.means,
        gaussians.quats,
        gaussians.log_scales,
        gaussians.logit_opacities,
        gaussians.sh,
        rows,
        len(rows),
        _pack(camera, options),
        options.threshold,
        options.mode == "antialiased",
        min(options.sh_degree, gaussians.sh_degree),
        out_rows,
        records,
        threads,
    )
    out_rows, records = out_rows[:num_splats], records[:num_splats]
    order = np.empty(num_splats, np.int32)
    _core.order_splats(records, out_rows, ids, order, threads)
    return Splats(out_rows, records, order)


def _pack(camera: Camera, options: ResolvedOptions) -> Float64[Array, "25"]:
    """The numbers of the struct View in shared/project.h, in its order."""
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    # Not −Rᵀt: the rotation may be off by 1e-4, and then the pixels of far Gaussians would move.
    center = np.linalg.solve(rotation, -translation)
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    before, after = np.array([cx / fx, cy / fy]), np.array([(camera.width - cx) / fx, (camera.height - cy) / fy])
    margin = (FRUSTUM_CLAMP - 1.0) * (before + after) / 2
    (min_x, min_y), (max_x, max_y) = -before - margin, after + margin
    size = [camera.width, camera.height, camera.near]
    slopes = [min_x, max_x, min_y, max_y]
    limits = [max(options.dilation_px2, DILATION_MIN_PX2), SIGMA_MAX_PX / max(fx, fy)]
    return np.array([*rotation.ravel(), *center, fx, fy, cx, cy, *size, *slopes, *limits], np.float64)


def _empty_records(num_rows: int) -> Float32[Array, "v 16"]:
    """Space for records that starts at a cache line; pages that are never written cost nothing."""
    space = np.empty(16 * num_rows + 16, np.float32)
    skip = -space.ctypes.data % 64 // 4
    return space[skip : skip + 16 * num_rows].reshape(num_rows, 16)
