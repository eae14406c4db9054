"""Derivatives of a loss by what was drawn: the definition.

**Over pixels** (`blend_backward`). With the weight w = T α of a splat at a pixel, the picture is C = Σ w c + T_end B. The light
that comes from behind a splat is R = Σ_later w (∂·c) + T_end (∂·B) for the derivative ∂ = ∂loss/∂C. By Kerbl 2023,
§4 and Appendix A, written for ln α instead of α:

    h = ∂loss/∂ln α = T α (∂·c) − R α / (1 − α),     0 where α is held at 0.99

With L scaled so that α = o 2^−(u² + v²), all that a splat's own derivatives need are Σ h (1, u, v, u², u v, v²) and Σ w ∂.

**Of one splat** (`project_backward`). f = 2 ln 2, and a, b, c are the entries of L in that scale:

    centre      f Lᵀ (H_u, H_v)
    covariance  ½ f² Lᵀ [[H_uu, H_uv], [H_uv, H_vv]] L,   the off-diagonal entry counted for one number Σ_xy
    opacity     H (1 − o) by the logit;   antialiased: H also moves √(det(Σ' − d I) / det Σ')

and from there through Σ' = M Mᵀ + d I, M = J W R S (project.py) to mean, quaternion and scales. The direction in which a splat is
seen moves its colour, where a channel is not clipped at 0.
"""

import math

import numpy as np

from splatree.constants import ALPHA_MAX, DILATION_MIN_PX2, SIGMA_MAX_PX, TILE_PX, TRANSMITTANCE_MIN
from splatree.errors import InputError
from splatree.maths.harmonics import basis_from_directions, basis_gradients
from splatree.maths.rotations import matrices_from_quats
from splatree.maths.slopes import held_slopes
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, PictureGradients, SplatGradients
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["blend_backward", "project_backward", "refuse_tapers"]

SCALE = np.sqrt(0.5 * np.log2(math.e))
"""exp(−½ q²) = 2^−(SCALE q)²."""

F = 2 * np.log(2)
"""Derivative of ln α by −(u² + v²) / 2."""


def refuse_tapers(bins: TileBins, view: View) -> None:
    """Raise InputError for splats that are tapered off, whose end has no derivative here."""
    if bins.floors is not None:
        raise InputError(
            f"backward: found pixels {view.pixels!r} with floors, wanted 'hard': tapers have no derivative"
        )


def blend_backward(
    splats: Splats,
    bins: TileBins,
    view: View,
    picture: Picture,
    upstream: PictureGradients,
    *,
    threads: int = 0,
) -> SplatGradients:
    """Sums over the pixels of each splat; ``threads`` is not used."""
    refuse_tapers(bins, view)
    by_color = upstream.image.astype(np.float64)
    by_alpha = np.zeros(by_color.shape[:2]) if upstream.alpha is None else upstream.alpha.astype(np.float64)
    by_depth = np.zeros_like(by_alpha)
    if upstream.depth is not None:  # depth = D / alpha
        alpha = picture.alpha.astype(np.float64)
        by_depth = np.divide(upstream.depth, alpha, out=by_depth, where=alpha > 0)
        assert picture.depth is not None  # whoever has a derivative by the depth has the depth
        by_alpha = by_alpha - by_depth * picture.depth
    by_end = by_color @ np.asarray(view.background) - by_alpha
    errors = np.zeros_like(by_alpha) if upstream.errors is None else upstream.errors
    sums = np.zeros((len(splats), 12))  # six moments, three colours, depth, weight, error
    for tile in range(bins.num_tiles_x * bins.num_tiles_y):
        y, x = (TILE_PX * i for i in divmod(tile, bins.num_tiles_x))
        area = np.s_[y : y + TILE_PX, x : x + TILE_PX]
        pairs = bins.splat_from_pair[bins.tile_start[tile] : bins.tile_start[tile + 1]]
        given = (by_color[area], by_depth[area], by_end[area], errors[area])
        _blend_tile(splats, pairs, (x, y), view.pixel_threshold, given, sums)
    kept = sums.astype(np.float32)
    has_errors = upstream.errors is not None
    return SplatGradients(
        kept[:, :6].copy(),
        kept[:, 6:9].copy(),
        None if upstream.depth is None else kept[:, 9].copy(),
        kept[:, 10].copy() if has_errors else None,
        kept[:, 11].copy() if has_errors else None,
    )


def _blend_tile(
    splats: Splats, pairs: Array, corner: tuple[int, int], threshold: float, given: tuple[Array, ...], sums: Array
) -> None:
    """Add what the pixels of one tile give: forwards as blend.py does, then backwards with the light from behind."""
    by_color, by_depth, by_end, errors = given
    records = splats.records.astype(np.float64)
    y, x = np.indices(by_end.shape) + 0.5
    T, finished, drawn_pairs = np.ones(by_end.shape), np.zeros(by_end.shape, bool), []
    for i in pairs:
        dx, dy = corner[0] + x - records[i, 0], corner[1] + y - records[i, 1]
        a, b, c = SCALE * records[i, 2:5]
        u, v = a * dx + b * dy, c * dy
        whole = records[i, 5] * 2.0 ** -(u * u + v * v)
        alpha = np.minimum(ALPHA_MAX, whole)
        drawn = (whole >= threshold) & ~finished
        finished |= drawn & (T * (1 - alpha) < TRANSMITTANCE_MIN)
        drawn &= ~finished
        alpha = np.where(drawn, alpha, 0.0)
        drawn_pairs.append((i, u, v, alpha, T, drawn & (whole <= ALPHA_MAX)))
        T = T * (1 - alpha)
    behind = T * by_end
    for i, u, v, alpha, before, moves in reversed(drawn_pairs):
        weight = before * alpha
        light = weight * (by_color @ records[i, 7:10] + by_depth * records[i, 10])
        h = np.where(moves, light - behind * alpha / (1 - alpha), 0.0)
        behind = behind + light
        moments = [np.sum(h * f) for f in (1.0, u, v, u * u, u * v, v * v)]
        colors = np.sum(weight[..., None] * by_color, axis=(0, 1))
        sums[i] += [*moments, *colors, np.sum(weight * by_depth), weight.sum(), np.sum(weight * errors)]


def project_backward(
    gaussians: Gaussians, splats: Splats, gradients: SplatGradients, view: View, *, threads: int = 0
) -> GaussianGradients:
    """Derivatives by the columns of the Gaussians that the splats come from; ``threads`` is not used."""
    camera, g = view.camera, gaussians.take(splats.rows)
    W, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    x, y, z = (g.means.astype(np.float64) @ W.T + t).T
    (low_x, high_x), (low_y, high_y) = held_slopes(fx, cx, camera.width), held_slopes(fy, cy, camera.height)
    ux, uy = np.clip(x / z, low_x, high_x), np.clip(y / z, low_y, high_y)
    free_x, free_y = (ux == x / z), (uy == y / z)
    tx = (fx / z)[:, None] * (W[0] - ux[:, None] * W[2])  # [v 3]
    ty = (fy / z)[:, None] * (W[1] - uy[:, None] * W[2])
    largest = (SIGMA_MAX_PX * z / max(fx, fy))[:, None]
    scales = np.minimum(np.exp(g.log_scales.astype(np.float64)), largest)
    axes = np.moveaxis(matrices_from_quats(g.quats), 2, 1)  # [v axis 3]
    mx, my = scales * np.einsum("vkj,vj->vk", axes, tx), scales * np.einsum("vkj,vj->vk", axes, ty)

    # Of the splat: centre and covariance.
    H, Hu, Hv, Huu, Huv, Hvv = gradients.moments.astype(np.float64).T
    a, b, c = SCALE * splats.factors.astype(np.float64).T
    gx, gy = F * a * Hu, F * (b * Hu + c * Hv)
    gxx = 0.5 * F**2 * a * a * Huu
    gxy = F**2 * a * (b * Huu + c * Huv)
    gyy = 0.5 * F**2 * (b * b * Huu + 2 * b * c * Huv + c * c * Hvv)
    if view.mode == "antialiased":
        d = max(view.dilation_px2, DILATION_MIN_PX2)
        xx, yy, xy = np.sum(mx * mx, 1), np.sum(my * my, 1), np.sum(mx * my, 1)
        bare = np.sum(np.cross(mx, my) ** 2, axis=1) + 1e-30
        det = bare + d * (xx + yy) + d * d
        gxx += 0.5 * H * (yy / bare - (yy + d) / det)
        gyy += 0.5 * H * (xx / bare - (xx + d) / det)
        gxy += H * xy * (1 / det - 1 / bare)

    # Through M to scales, axes and the rows of J W.
    by_mx, by_my = 2 * gxx[:, None] * mx + gxy[:, None] * my, 2 * gyy[:, None] * my + gxy[:, None] * mx
    by_log_scales = by_mx * mx + by_my * my
    is_held = np.exp(g.log_scales.astype(np.float64)) > largest
    held = np.sum(np.where(is_held, by_log_scales, 0.0), axis=1)  # these grow with the depth instead
    by_axes = scales[..., None] * (by_mx[..., None] * tx[:, None] + by_my[..., None] * ty[:, None])  # [v axis 3]
    by_tx, by_ty = np.einsum("vk,vkj->vj", scales * by_mx, axes), np.einsum("vk,vkj->vj", scales * by_my, axes)

    # To the mean, in the axes of the camera.
    ex = (gx * fx - np.where(free_x, fx / z * (by_tx @ W[2]), 0.0)) / z
    ey = (gy * fy - np.where(free_y, fy / z * (by_ty @ W[2]), 0.0)) / z
    ez = (held - ex * x - ey * y - np.sum(by_tx * tx + by_ty * ty, axis=1)) / z
    if gradients.depths is not None:
        ez = ez + gradients.depths
    by_means = np.stack([ex, ey, ez], axis=1) @ W

    # Colour: by the harmonics, and by the direction that they are seen in.
    degree = min(view.sh_degree, g.sh_degree)
    offset = g.means.astype(np.float64) - camera.position
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    n = offset / distance
    by_color = np.where(splats.colors > 0, gradients.colors.astype(np.float64), 0.0)
    basis = basis_from_directions(n, degree)
    by_sh = np.zeros(g.sh.shape)
    by_sh[:, : basis.shape[1]] = basis[..., None] * by_color[:, None]
    along = np.einsum("vkc,vc->vk", g.sh[:, : basis.shape[1]].astype(np.float64), by_color)
    by_n = np.einsum("vkj,vk->vj", basis_gradients(n, degree), along)
    by_means = by_means + (by_n - n * np.sum(n * by_n, axis=1, keepdims=True)) / distance

    columns = (
        by_means,
        _by_quats(g.quats, by_axes),
        np.where(is_held, 0.0, by_log_scales),
        H * (1 - g.opacities()),
        by_sh,
    )
    return GaussianGradients(splats.rows, *(column.astype(np.float32) for column in columns))


def _by_quats(quats: Array, by_axes: Array) -> Array:
    """By quaternions of any length, from the derivatives by the three axes that they turn to."""
    q = quats.astype(np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    n = np.divide(q, length, out=np.tile([1.0, 0, 0, 0], (len(q), 1)), where=length > 0)
    w, x, y, z = n.T
    (a00, a01, a02), (a10, a11, a12), (a20, a21, a22) = np.moveaxis(by_axes, 0, 2)
    d = 2 * np.stack(
        [
            z * (a01 - a10) + y * (a20 - a02) + x * (a12 - a21),
            y * (a01 + a10) + z * (a02 + a20) + w * (a12 - a21) - 2 * x * (a11 + a22),
            x * (a01 + a10) + z * (a12 + a21) + w * (a20 - a02) - 2 * y * (a00 + a22),
            x * (a02 + a20) + y * (a12 + a21) + w * (a01 - a10) - 2 * z * (a00 + a11),
        ],
        axis=1,
    )
    across = d - n * np.sum(n * d, axis=1, keepdims=True)
    return np.asarray(np.divide(across, length, out=np.zeros_like(across), where=length > 0))
