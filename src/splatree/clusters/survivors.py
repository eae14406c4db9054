"""Which Gaussians survive step 1 of a rasteriser, the projection: what a rule of culling must not lose.

Three rasterisers, each by its own rule, in float32 as they compute:

``exact``         ours: the projection kernel itself
``exact-inria``   Kerbl 2023: a square of ⌈3 √λ⌉ px that meets a tile of 16 × 16 px
``exact-gsplat``  gsplat 1.x: a box of ⌈min(3.33, √(2 ln 255 o)) √Σ'ii⌉ px that meets the image, from o = 1/255 on

Cost: some dozen passes over all rows in NumPy for the last two; they are there to measure and to test.
"""

from typing import NamedTuple

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, DILATION_PX2, EIGENVALUE_FLOOR_PX4, SIGMAS, TILE_PX
from splatree.errors import InputError
from splatree.kernels.cpu.frame.project import project
from splatree.maths.rotations import matrices_from_quats
from splatree.maths.slopes import held_slopes
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import Cull
from splatree.scene.view import View
from splatree.shapes import Array, Bool

__all__ = ["survivors"]

GSPLAT_REACH_MAX = 3.33
"""Standard deviations that a box of gsplat has at most."""


def survivors(gaussians: Gaussians, view: View, rule: Cull) -> Bool[Array, "n"]:
    """Whether each row touches the image, by the rasteriser that the rule speaks of."""
    camera = view.camera
    if rule == "exact":
        found = np.zeros(len(gaussians), bool)
        found[project(gaussians, None, np.arange(len(gaussians), dtype=np.int32), view).rows] = True
        return found
    if rule not in ("exact-inria", "exact-gsplat"):
        raise InputError(f"survivors: found {rule!r}, wanted exact, exact-inria or exact-gsplat")
    with np.errstate(all="ignore"):  # float32 overflows for absurd rows, as it does in the rasterisers
        splats = _project(gaussians, camera, symmetric=rule == "exact-inria")
        touches = _squares_meet_tiles if rule == "exact-inria" else _boxes_meet_image
        return np.asarray(touches(splats, gaussians, camera) & (splats.depth > np.float32(camera.near)))


class _Splats(NamedTuple):
    x: Array
    y: Array
    depth: Array
    xx: Array  # dilated covariance
    xy: Array
    yy: Array


def _project(gaussians: Gaussians, camera: Camera, *, symmetric: bool) -> _Splats:
    """Centres and dilated covariances in float32. ``symmetric``: slopes are held as if the principal point were in the middle."""
    view = camera.camera_from_world[:3].astype(np.float32)
    x, y, z = (sum(view[i, j] * gaussians.means[:, j] for j in range(3)) + view[i, 3] for i in range(3))
    (fx, _, cx), (_, fy, cy), _ = camera.K.astype(np.float32)
    held = []
    for slope, focal, centre, size in ((x / z, fx, cx, camera.width), (y / z, fy, cy, camera.height)):
        low, high = held_slopes(float(focal), size / 2 if symmetric else float(centre), size)
        held.append(np.clip(slope, np.float32(low), np.float32(high)))
    axes = matrices_from_quats(gaussians.quats).astype(np.float32) * np.exp(gaussians.log_scales)[:, None, :]
    seen = [sum(view[i, j] * axes[:, j] for j in range(3)) for i in range(3)]  # rows of W R S, [n 3] each
    first = (fx / z)[:, None] * (seen[0] - held[0][:, None] * seen[2])
    second = (fy / z)[:, None] * (seen[1] - held[1][:, None] * seen[2])
    dilation = np.float32(DILATION_PX2)
    xx, xy, yy = (
        a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
        for a, b in ((first, first), (first, second), (second, second))
    )
    return _Splats(fx * x / z + cx, fy * y / z + cy, z, xx + dilation, xy, yy + dilation)


def _squares_meet_tiles(splats: _Splats, gaussians: Gaussians, camera: Camera) -> Array:
    det = splats.xx * splats.yy - splats.xy * splats.xy
    middle = np.float32(0.5) * (splats.xx + splats.yy)
    larger = middle + np.sqrt(np.maximum(np.float32(EIGENVALUE_FLOOR_PX4), middle * middle - det))
    radius = np.ceil(np.float32(SIGMAS) * np.sqrt(larger))
    meets = det != 0
    for centre, size in ((splats.x, camera.width), (splats.y, camera.height)):
        at = centre - np.float32(0.5)  # its pixel centres have whole numbers
        tiles = -(-size // TILE_PX)
        first = np.clip(np.trunc((at - radius) / TILE_PX), 0, tiles)
        last = np.clip(np.trunc((at + radius + (TILE_PX - 1)) / TILE_PX), 0, tiles)
        meets &= first < last
    return np.asarray(meets)


def _boxes_meet_image(splats: _Splats, gaussians: Gaussians, camera: Camera) -> Array:
    with np.errstate(over="ignore"):  # exp(800) is infinite and gives 0, as it should
        opacities = 1 / (1 + np.exp(-gaussians.logit_opacities))
    reach = np.sqrt(2 * np.log(np.maximum(opacities / np.float32(ALPHA_THRESHOLD), 1)))
    reach = np.minimum(reach, np.float32(GSPLAT_REACH_MAX))
    meets = opacities >= np.float32(ALPHA_THRESHOLD)
    for centre, variance, size in ((splats.x, splats.xx, camera.width), (splats.y, splats.yy, camera.height)):
        radius = np.ceil(reach * np.sqrt(variance))
        meets &= (centre + radius > 0) & (centre - radius < size) & (radius > 0)
    return np.asarray(meets)
