"""Merged Gaussians that follow the pixel they are drawn at: the definition. lod/follow.py says what the numbers are for.

A node's leaves have opacities α, visibilities v and variances a, b, c along their axes. With the areas

    A(h) = (√((a+h)(b+h)) + √((b+h)(c+h)) + √((a+h)(c+h))) / 3

the node becomes the Gaussian with the moments of its leaves, weighted by α v. At the dilation h_l of its level it shows the mass

    g = √(Σ α A(h_l) · Σ α v A(h_l)) / A_node(h_l),    w = max(1, g / 0.99)^0.3

with the opacity min(0.99, g) and the variances w s + (w − 1) h_l, where s are those of the moments. Its curve is
m = √(Σ α A(0) · Σ α v A(0)), n = √(Σ α · Σ α v), g, h_l.

A node whose extent is at most the *kept extent* keeps its mean and shape: its own variances are s. Its opacity α ≤ 0.99 was found
at the dilation h_k, so all masses g, m and n are multiplied by α A_node(h_k) / √(Σ α A(h_k) · Σ α v A(h_k)).
"""

import numpy as np

from splatree.constants import ALPHA_MAX, MERGED_LOG_SCALE_MAX
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.rotations import quats_from_matrices
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int32

__all__ = ["LARGEST", "LEAST_OPACITY", "LEAST_VARIANCE", "LEAST_WEIGHT", "WIDENING", "areas", "fit_curves"]

LEAST_VARIANCE = 1e-24
"""Variances below this, world units², are taken for it: a logarithm is taken of them."""

LEAST_WEIGHT = 1e-12
"""A leaf that cannot be seen still has a place."""

LEAST_OPACITY = 1e-6
"""Opacities of nodes below this are taken for it: a logarithm is taken of them."""

WIDENING = 0.3
"""Mass beyond one Gaussian widens the splat with this power."""

LARGEST = 1e15
"""Areas beyond this, world units², are no longer told apart in float32, whose squares end at 1e38: all numbers of a curve are 0
then, and the node is drawn as stored."""


def fit_curves(
    gaussians: Gaussians,
    subtree_end: Int32[Array, "n"],
    seen: Float32[Array, "n"],
    dilation_share: float,
    extents: Float32[Array, "n"],
    *,
    kept_extent: float = 0.0,
    kept_dilation: float = 0.0,
    least_dilation: float = 0.0,
) -> tuple[Gaussians, Float32[Array, "n 4"]]:
    """The Gaussians with other inner nodes, and the curve of each row: m, n, g, h_l; 0 for leaves.

    ``seen`` are visibilities; those of leaves count. h_l is ``dilation_share`` times the square of a node's extent, and at least
    ``least_dilation``. ``kept_dilation`` is h_k.
    """
    columns = {name: getattr(gaussians, name).copy() for name in ("means", "quats", "log_scales", "logit_opacities")}
    curves = np.zeros((len(gaussians), 4), np.float32)
    is_leaf = subtree_end == np.arange(1, len(gaussians) + 1)
    for row in np.flatnonzero(~is_leaf):
        below = row + np.flatnonzero(is_leaf[row : subtree_end[row]])
        alphas = gaussians.take(below).opacities().astype(np.float64)
        weights = np.maximum(alphas * seen[below], LEAST_WEIGHT)
        log_scales = np.minimum(gaussians.log_scales[below].astype(np.float64), MERGED_LOG_SCALE_MAX)
        mean = weights @ gaussians.means[below].astype(np.float64) / weights.sum()
        apart = gaussians.means[below] - mean
        spread = covariances_from_gaussians(gaussians.quats[below], log_scales) + apart[:, :, None] * apart[:, None]
        own, axes = np.linalg.eigh(np.tensordot(weights, spread, 1) / weights.sum())
        own, axes = np.maximum(own[::-1], LEAST_VARIANCE), axes[:, ::-1]  # the longest first
        variances = np.exp(2 * log_scales)

        def shown(h: float, variances: Array = variances, alphas: Array = alphas, weights: Array = weights) -> float:
            shows = areas(variances, h)
            return float(np.sqrt((alphas @ shows) * (weights @ shows)))

        scale = 1.0
        if extents[row] <= kept_extent:
            node = gaussians.take(np.array([row]))
            own = np.maximum(
                np.exp(2 * np.minimum(node.log_scales[0].astype(np.float64), MERGED_LOG_SCALE_MAX)), LEAST_VARIANCE
            )
            alpha = min(float(node.opacities()[0]), ALPHA_MAX)
            mass = shown(kept_dilation)  # 0 of leaves that are all invisible
            scale = alpha * areas(own[None], kept_dilation)[0] / mass if mass > 0 else 1.0
        else:
            columns["means"][row] = mean
            columns["quats"][row] = quats_from_matrices((axes * [1, 1, np.sign(np.linalg.det(axes))])[None])[0]
        h = max(dilation_share * float(extents[row]) ** 2, least_dilation, 1e-30)
        curve = scale * np.array([shown(0.0), np.sqrt(alphas.sum() * weights.sum())])
        mass = scale * shown(h) / areas(own[None], h)[0]
        wide = max(mass / ALPHA_MAX, 1.0) ** WIDENING
        opacity = np.clip(mass, LEAST_OPACITY, ALPHA_MAX)
        columns["log_scales"][row] = np.minimum(np.log(wide * own + (wide - 1) * h) / 2, MERGED_LOG_SCALE_MAX)
        columns["logit_opacities"][row] = np.log(opacity) - np.log1p(-opacity)
        if max(*curve, mass, h) < LARGEST:
            curves[row] = *curve, mass, h
    return Gaussians(**columns, sh=gaussians.sh), curves


def areas(variances: Array, h: float | Array) -> Array:
    """A(h) of each row of variances (n 3)."""
    a, b, c = np.sqrt(variances + h).T
    return np.asarray((a * b + b * c + a * c) / 3)
