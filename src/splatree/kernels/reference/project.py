"""Project Gaussians to splats: the definition.

A Gaussian with mean μ and covariance Σ is seen as the 2D Gaussian of the local affine approximation (Zwicker 2002, Eq. 31;
Kerbl 2023, Eq. 5):

    Σ' = J W Σ Wᵀ Jᵀ + dilation · I

W is the rotation of the camera; J the Jacobian of the perspective at the mean, with the direction (x/z, y/z) held within the
image and 0.3 half fields of view around it (the 1.3 tan(fov/2) of Kerbl 2023, measured from the borders so that it also
holds for an off-centre principal point). In mode `antialiased` the opacity is multiplied by √(det(Σ' − dilation I) / det Σ'),
so that the dilation does not add light (Yu 2024, Eq. 9).

The splat is drawn down to an opacity θ, the smaller of τ and 1/255: |L d| ≤ k with k = √(2 ln(o/θ)), a box of half size
k √Σ'_xx by k √Σ'_yy. A Gaussian is dropped if its centre is not farther than `near`, if o < τ (by the tile rule `balanced` if
o < θ), or if the box holds no pixel centre's row or column; under a square tile rule (square.py) if its square is in no tile.
"""

import numpy as np

from splatree.constants import ALPHA_MAX, DILATION_MIN_PX2, SIGMA_MAX_PX
from splatree.kernels.reference.square import half_sides, rule_of, tile_range
from splatree.maths.harmonics import colors_from_harmonics
from splatree.maths.rotations import matrices_from_quats
from splatree.maths.slopes import held_slopes
from splatree.scene.frame import Splats
from splatree.scene.gaussians import Gaussians
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, UInt32

__all__ = ["follow", "project"]


def project(
    gaussians: Gaussians,
    ids: UInt32[Array, "n"] | None,
    rows: Int32[Array, "v"],
    view: View,
    *,
    curves: Float32[Array, "n 4"] | None = None,
    threads: int = 0,
) -> Splats:
    """Splats of the rows that touch the image; ``threads`` is not used."""
    camera = view.camera
    g = gaussians.take(rows)
    g_curves = np.zeros((len(g), 4)) if curves is None else curves[rows].astype(np.float64)
    W, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    points = g.means.astype(np.float64) @ W.T + t  # [v 3]
    kept = points[:, 2] > camera.near
    g, points, rows, g_curves = g.take(kept), points[kept], rows[kept], g_curves[kept]
    x, y, z = points.T
    means_px = np.stack([fx * x / z + cx, fy * y / z + cy], axis=1)

    # The Jacobian at the clamped direction, and the factor M = J W R S with Σ' = M Mᵀ + dilation I.
    ux = np.clip(x / z, *held_slopes(fx, cx, camera.width))
    uy = np.clip(y / z, *held_slopes(fy, cy, camera.height))
    zero = np.zeros_like(z)
    J = np.stack(
        [np.stack([fx / z, zero, -fx * ux / z], -1), np.stack([zero, fy / z, -fy * uy / z], -1)], -2
    )  # [v 2 3]
    largest = SIGMA_MAX_PX * z / max(fx, fy)
    scales = np.exp(np.minimum(g.log_scales, np.log(largest)[:, None], dtype=np.float64))
    opacities = g.opacities()
    if view.mode == "classic":
        scales, opacities = follow(g_curves, view.dilation_px2 * z**2 / (fx * fy), scales, opacities)
    M = J @ W @ matrices_from_quats(g.quats) * scales[:, None, :]  # [v 2 3]

    # The determinant as a sum of positive terms: A C − B² would cancel for long thin splats.
    dilation = max(view.dilation_px2, DILATION_MIN_PX2)
    xx, yy, xy = (np.sum(M[:, i] * M[:, j], axis=1) for i, j in ((0, 0), (1, 1), (0, 1)))
    undilated_det = np.sum(np.cross(M[:, 0], M[:, 1]) ** 2, axis=1)
    det = undilated_det + dilation * (xx + yy) + dilation**2
    xx, yy = xx + dilation, yy + dilation

    if view.mode == "antialiased":
        opacities = opacities * np.sqrt(undilated_det / det)
    threshold = view.pixel_threshold
    k_squared = 2 * np.log(np.maximum(opacities, threshold) / threshold)
    half_sizes_px = np.sqrt(k_squared[:, None] * np.stack([xx, yy], axis=1))

    a = np.sqrt(yy / det)
    factors = np.stack([a, -a * xy / yy, np.sqrt(1 / yy)], axis=1)
    size = np.array([camera.width, camera.height])
    if not view.is_square:
        touches = ((means_px + half_sizes_px >= 0.5) & (means_px - half_sizes_px <= size - 0.5)).all(axis=1)
    else:
        sides = half_sides(xx, xy, yy, opacities, rule_of(view))
        ranges = [tile_range(means_px[:, axis], sides, int(size[axis])) for axis in range(2)]
        touches = np.logical_and(*(first < end for first, end in ranges))
    visible = touches & (opacities >= view.least_opacity)

    directions = (points @ W)[visible]  # from the eye, in the world
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    degree = min(view.sh_degree, g.sh_degree)
    colors = colors_from_harmonics(g.sh[visible], directions, degree)

    records = np.zeros((int(visible.sum()), 16), np.float32)
    records[:, 0:2], records[:, 2:5] = means_px[visible], factors[visible]
    records[:, 5], records[:, 6] = opacities[visible], np.log2(np.maximum(opacities[visible], 1e-37))
    records[:, 7:10], records[:, 10], records[:, 11:13] = colors, z[visible], half_sizes_px[visible]
    rows = np.ascontiguousarray(rows[visible])
    order = np.lexsort((rows if ids is None else ids[rows], records[:, 10])).astype(np.int32)
    return Splats(rows, records, order)


def follow(curves: Array, dilations: Array, scales: Array, opacities: Array) -> tuple[Array, Array]:
    """Scales and opacities with which rows are drawn at a dilation h, world units² (lod/follow.py).

    A curve is (m, n, g, h_l). With w(x) = max(x / 0.99, 1)^0.3 the variances without widening are
    v = (σ² − (w(g) − 1) h_l) / w(g).
    Beyond h_l a node is drawn as at h_l. The mass G = √(m² + b h + (n h)²) / A(v, h), b such that G(h_l) = g, at most g, gives
    the opacity min(0.99, G) and the variances w(G) v + (w(G) − 1) h. Rows with g = 0 are drawn as stored.
    """
    bare, far, peak, level = curves.T
    follows = peak > 0
    stored = _widening(peak)
    v = np.maximum(scales.T**2 - (stored - 1) * level, 0) / stored
    h = np.minimum(dilations, level)
    slope = np.maximum((peak * _area(v, level)) ** 2 - bare**2 - (far * level) ** 2, 0) / np.where(follows, level, 1)
    mass = np.minimum(np.sqrt(bare**2 + slope * h + (far * h) ** 2) / _area(v, h), peak)
    wide = _widening(mass)
    drawn = np.sqrt(wide * v + (wide - 1) * h).T
    return np.where(follows[:, None], drawn, scales), np.where(follows, np.minimum(mass, ALPHA_MAX), opacities)


def _widening(mass: Array) -> Array:
    return np.asarray(np.maximum(mass / ALPHA_MAX, 1) ** 0.3)


def _area(variances: Array, dilations: Array) -> Array:
    x, y, z = np.sqrt(variances + dilations)
    return np.asarray(np.maximum((x * y + y * z + x * z) / 3, 1e-37))
