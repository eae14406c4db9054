"""How much merging two Gaussians changes the picture, and each one's cheapest partner: the definition.

A Gaussian shows the signal α (c, 1) G: its colour, and 1 for what it hides, where G is 1 at its centre. Two of them, i and j,
become m with the moments of both (weights w) and an opacity α_m. The cost is the squared difference of what is shown, seen
along the three axes of the world, and α_m is what makes it least:

    E = Σ_planes ∫ |α_i c_i G_i + α_j c_j G_j − α_m c_m G_m|²,    α_m = (α_i c_i·c_m ⟨i m⟩ + α_j c_j·c_m ⟨j m⟩) / (c_m·c_m ⟨m m⟩)

with the overlap ⟨1 2⟩ = ∫ G₁ G₂ / π = 2 √(|S₁| |S₂| / |S|) exp(−½ dᵀ S⁻¹ d), S = S₁ + S₂, over the 2 × 2 blocks of the
covariances. The renderer's dilation is added to all three; without it a scene of mode `classic` would lose the small
Gaussians that it draws a pixel wide. A Gaussian thinner than 1/256 of its length counts as that thick, and a
determinant is at least 1e-6 of the product of its diagonal: float32 then holds the result. Hidden Gaussians
count less (visibility.py): each α stands for its product with the visibility, and m has the weighted mean of the visibilities.

Candidates are the 8 nearest rows by the distance of their means. Cost: O(n²) here.
"""

import numpy as np

from splatree.constants import SH_C0
from splatree.maths.covariance import covariances_from_gaussians
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["NUM_NEIGHBORS", "best_partners", "energies", "pair_costs"]

NUM_NEIGHBORS = 8
"""Candidates of each row."""

ROUNDNESS = 1 / 256
"""Smallest thickness of a Gaussian, in units of its longest axis."""

PLANES = ((0, 1), (0, 2), (1, 2))


def best_partners(
    gaussians: Gaussians,
    weights: Float32[Array, "n"],
    visibilities: Float32[Array, "n"] | None = None,
    *,
    dilation: float,
) -> tuple[Int32[Array, "n"], Float32[Array, "n"], Float32[Array, "n"]]:
    """Each row's cheapest partner (−1 if it is alone), the cost, and the opacity of the two merged."""
    n = len(gaussians)
    partner = np.full(n, -1, np.int32)
    costs, opacities = np.full(n, np.inf, np.float32), np.zeros(n, np.float32)
    for i in range(n):
        apart = np.sum((gaussians.means - gaussians.means[i]).astype(np.float64) ** 2, axis=1)
        apart[i] = np.inf
        nearest = np.argsort(apart, kind="stable")[: min(NUM_NEIGHBORS, n - 1)]
        if len(nearest):
            found, alphas = pair_costs(
                gaussians, weights, np.full(len(nearest), i), nearest, visibilities, dilation=dilation
            )
            best = int(np.argmin(found))
            partner[i], costs[i], opacities[i] = nearest[best], found[best], alphas[best]
    return partner, costs, opacities


def pair_costs(
    gaussians: Gaussians,
    weights: Float32[Array, "n"],
    first: Array,
    second: Array,
    visibilities: Float32[Array, "n"] | None = None,
    *,
    dilation: float,
) -> tuple[Array, Array]:
    """Cost and merged opacity of each pair of rows; ``dilation`` is added to every variance, world units²."""
    covariances, v, alphas, shown = _signals(gaussians, visibilities, dilation)
    w = weights.astype(np.float64)
    share = (w[second] / (w[first] + w[second]))[:, None]
    apart = (gaussians.means[second] - gaussians.means[first]).astype(np.float64)
    spread = (share * (1 - share))[:, :, None] * apart[:, :, None] * apart[:, None, :]
    p, q = covariances[first], covariances[second]
    m = (1 - share)[:, :, None] * p + share[:, :, None] * q + spread
    shown_p, shown_q = alphas[first][:, None] * shown[first], alphas[second][:, None] * shown[second]
    shown_m = (1 - share) * shown[first] + share * shown[second]

    at_place = np.zeros_like(apart)
    of_pair = (
        np.sum(shown_p**2, axis=1) * _overlap(p, p, at_place)
        + np.sum(shown_q**2, axis=1) * _overlap(q, q, at_place)
        + 2 * np.sum(shown_p * shown_q, axis=1) * _overlap(p, q, apart)
    )
    in_common = np.sum(shown_p * shown_m, axis=1) * _overlap(p, m, share * apart)
    in_common += np.sum(shown_q * shown_m, axis=1) * _overlap(q, m, (1 - share) * apart)
    of_one = np.sum(shown_m**2, axis=1) * _overlap(m, m, at_place)
    visible = (1 - share[:, 0]) * v[first] + share[:, 0] * v[second]
    alpha = np.clip(in_common / of_one, 1e-4 * visible, 0.999 * visible)
    return of_pair - 2 * alpha * in_common + alpha**2 * of_one, alpha / visible


def energies(
    gaussians: Gaussians, visibilities: Float32[Array, "n"] | None = None, *, dilation: float
) -> Float64[Array, "n"]:
    """What each Gaussian shows, squared: e = α² |(c, 1)|² ⟨G G⟩, world units²."""
    covariances, _, alphas, shown = _signals(gaussians, visibilities, dilation)
    at_place = np.zeros((len(gaussians), 3))
    energy: Float64[Array, n] = alphas**2 * np.sum(shown**2, axis=1) * _overlap(covariances, covariances, at_place)
    return energy


def _signals(
    gaussians: Gaussians, visibilities: Array | None, dilation: float
) -> tuple[Float64[Array, "n 3 3"], Float64[Array, "n"], Float64[Array, "n"], Float64[Array, "n 4"]]:
    """The covariances, visibilities, opacities times visibilities, and (c, 1) of all rows."""
    thickness = dilation + (ROUNDNESS * gaussians.scales().max(axis=1)) ** 2
    covariances = covariances_from_gaussians(gaussians.quats, gaussians.log_scales)
    covariances = covariances + thickness[:, None, None] * np.eye(3)
    v = np.ones(len(gaussians)) if visibilities is None else visibilities.astype(np.float64)
    colors = np.maximum(gaussians.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0)
    return covariances, v, v * gaussians.opacities(), np.concatenate([colors, np.ones((len(gaussians), 1))], axis=1)


def _overlap(first: Array, second: Array, apart: Array) -> Array:
    """⟨1 2⟩, summed over the planes."""

    def determinant(a: Array, b: Array, c: Array) -> Array:
        return np.asarray(np.maximum(a * c - b * b, 1e-6 * a * c))

    total = np.zeros(len(first))
    for i, j in PLANES:
        (a1, b1, c1), (a2, b2, c2) = ((s[:, i, i], s[:, i, j], s[:, j, j]) for s in (first, second))
        a, b, c, u, v = a1 + a2, b1 + b2, c1 + c2, apart[:, i], apart[:, j]
        sum_det = determinant(a, b, c)
        distance2 = (c * u * u - 2 * b * u * v + a * v * v) / sum_det
        area2 = determinant(a1, b1, c1) * determinant(a2, b2, c2) / sum_det
        total += 2 * np.sqrt(area2) * np.exp(-distance2 / 2)
    return total
