"""Merging: one Gaussian from each group of rows.

With weights w and W = Σ w, position x = Σ w x / W (or the representative's) and harmonics f = Σ w f / W. Then by named rules:

shape     ``moments``  Σ = Σ w (Σ_i + d dᵀ) / W with d = x_i − x: the group's covariance as one distribution
          ``mean``     σ_a² = Σ w (|d|² + σ_{i,a}²) / W for each axis, quaternions averaged in the representative's hemisphere
bound     σ_a ≤ κ Σ w σ_{i,a} / W (``moments``: of the members' longest axes, as the axes are no longer theirs)
opacity   ``union``    u = 1 − Π (1 − α_i)
          ``mass``     m = Σ α_i A_i / A, with A the mean projected area of an ellipsoid
          ``standard`` max(u, m); what of m is above 1 (up to ``mass_limit``) widens the Gaussian by m^``widening``

          ``optical``  α with Li₂(α) A = Σ Li₂(α_i) A_i: the integral of −log(1 − α g) over a Gaussian g is A Li₂(α), so the light
                       that passes is kept as it multiplies through layers; a depth T beyond Li₂(0.999) cannot be drawn
                       and widens the Gaussian by √Ein, as ∫ 1 − e^(−T g) = A Ein(T) is what a stack of depth T covers

Opacities stay below 0.999. ``dilation`` h adds h σ_max² (of the merged Gaussian) to every variance inside A: a renderer of
mode ``classic`` adds 0.3 px² to every splat, and at the distance where the merged Gaussian comes into use a pixel is about
its σ_max. A group of one is copied bit for bit.

Deviation from the radius scheme's text: its σ_pos² is used for every axis, as written, but quaternions are normalised before
they are averaged, so that their stored length is no weight.
"""

from dataclasses import fields

import numpy as np

from splatree.constants import MERGED_ALPHA_MAX, MERGED_LOG_SCALE_MAX
from splatree.maths.covariance import covariances_from_gaussians
from splatree.scene.gaussians import Gaussians
from splatree.scene.thinning import Groups, MergeOptions
from splatree.shapes import Array, Float32

__all__ = ["coverage", "dilogarithm", "mean_projected_area", "merge", "quat_from_matrix"]


def merge(
    gaussians: Gaussians,
    groups: Groups,
    weights: Float32[Array, "n"],
    options: MergeOptions,
    *,
    added: float = 0.0,
    opacities: Float32[Array, "g"] | None = None,
) -> Gaussians:
    """One Gaussian for each group, in the order of the groups; ``options`` resolved.

    ``added`` is added to variances where areas are compared, world units², besides the options' dilation.
    Where ``opacities`` is above 0, it is what a group of two or more gets in place of the rule's.
    """
    given = np.zeros(len(groups)) if opacities is None else opacities.astype(np.float64)
    rows = [
        _merge_members(gaussians, groups.rows[begin:end], int(representative), weights, options, added, alpha)
        for begin, end, representative, alpha in zip(
            groups.start[:-1], groups.start[1:], groups.representatives, given, strict=True
        )
    ]
    if not rows:
        return Gaussians.empty(gaussians.sh_degree)
    return Gaussians(*(np.stack([row[i] for row in rows]).astype(np.float32) for i in range(len(fields(Gaussians)))))


def _merge_members(
    gaussians: Gaussians,
    rows: Array,
    representative: int,
    weights: Array,
    options: MergeOptions,
    added: float,
    alpha: float,
) -> tuple[Array, Array, Array, Array, Array]:
    if len(rows) == 1:
        i = rows[0]
        g = gaussians
        return g.means[i], g.quats[i], g.log_scales[i], g.logit_opacities[i], g.sh[i]
    share = weights[rows].astype(np.float64)
    share = share / share.sum()
    means = gaussians.means[rows].astype(np.float64)
    log_scales = np.clip(gaussians.log_scales[rows].astype(np.float64), -MERGED_LOG_SCALE_MAX, MERGED_LOG_SCALE_MAX)
    sigmas = np.exp(log_scales)
    quats = gaussians.quats[rows].astype(np.float64)

    mean = share @ means if options.position == "centroid" else gaussians.means[representative].astype(np.float64)
    offsets = means - mean
    if options.rule == "moments":
        spread = np.einsum("n,ni,nj->ij", share, offsets, offsets)
        covariance = np.einsum("n,nij->ij", share, covariances_from_gaussians(quats, log_scales)) + spread
        values, axes = np.linalg.eigh(covariance)
        variances, axes = values[::-1], axes[:, ::-1].copy()
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        quat = quat_from_matrix(axes)
        # Below 1e-15 of the largest, an eigenvalue is rounding.
        variances = np.maximum(variances, max(1e-15 * variances[0], np.exp(-2 * MERGED_LOG_SCALE_MAX)))
        bounds = np.full(3, options.bound * (share @ sigmas.max(axis=1)))
    else:
        variances = share @ sigmas**2 + share @ np.sum(offsets**2, axis=1)
        units = quats / np.linalg.norm(quats, axis=1, keepdims=True)
        reference = gaussians.quats[representative].astype(np.float64)
        quat = share @ (units * np.where(units @ reference < 0, -1, 1)[:, None])
        norm = np.linalg.norm(quat)
        quat = quat / norm if norm > 1e-9 else reference
        bounds = options.bound * (share @ sigmas)
    variances = np.minimum(variances, bounds**2)

    logits = gaussians.logit_opacities[rows].astype(np.float64)
    logit, widening = float(np.log(alpha) - np.log1p(-alpha)) if alpha > 0 else 0.0, 0.0
    if not alpha > 0:
        logit, widening = _merge_opacity(logits, sigmas**2, variances, options, added)
    sh = np.einsum("n,nkc->kc", share, gaussians.sh[rows].astype(np.float64))
    return mean, quat, 0.5 * np.log(variances) + widening, np.asarray(logit), sh


def _merge_opacity(
    logits: Array, member_variances: Array, variances: Array, options: MergeOptions, added: float
) -> tuple[float, float]:
    """Logit of the merged opacity, and what is added to the logarithm of the scales."""
    alphas = 1 / (1 + np.exp(-logits))
    log_through = -np.sum(np.logaddexp(0, logits))  # log Π (1 − α)
    union_logit = -log_through if log_through < -700 else float(np.log(np.expm1(-log_through)))
    limit = float(np.log(MERGED_ALPHA_MAX / (1 - MERGED_ALPHA_MAX)))
    if options.opacity == "union":
        return min(union_logit, limit), 0.0
    added += (options.dilation or 0.0) * variances.max()
    areas = np.array([mean_projected_area(v + added) for v in member_variances])
    if options.opacity == "optical":
        depth = float(sum(dilogarithm(a) * area for a, area in zip(alphas, areas, strict=True)))
        depth /= mean_projected_area(variances + added)
        most = dilogarithm(MERGED_ALPHA_MAX)
        if depth > most:
            return limit, 0.5 * float(np.log(coverage(depth) / coverage(most)))
        low, high = 0.0, MERGED_ALPHA_MAX
        for _ in range(200):
            middle = (low + high) / 2
            low, high = (low, middle) if dilogarithm(middle) > depth else (middle, high)
        return (float(np.log(high) - np.log1p(-high)) if depth > 0 else union_logit), 0.0
    mass = float(alphas @ areas) / mean_projected_area(variances + added)
    bounded = min(mass, MERGED_ALPHA_MAX)
    mass_logit = float(np.log(bounded) - np.log1p(-bounded)) if mass > 0 else union_logit
    if options.opacity == "mass":
        return mass_logit, 0.0
    logit = mass_logit if mass > -np.expm1(log_through) else min(union_logit, limit)
    return logit, options.power * float(np.log(min(mass, options.mass_limit))) if mass > 1 else 0.0


def mean_projected_area(variances: Array) -> float:
    """Area / π of the shadow of an ellipsoid, averaged over all directions.

    It is a quarter of the surface (Cauchy 1841); the surface is Thomsen's approximation, within 1.1 %.
    """
    power = 1.6075
    a, b, c = np.log(np.asarray(variances, np.float64)) / 2
    terms = power * np.array([a + b, a + c, b + c])
    return float(np.exp((np.logaddexp.reduce(terms) - np.log(3)) / power))


def dilogarithm(x: float) -> float:
    """Li₂(x) = Σ x^k / k² on [0, 1]; above ½ by Euler's reflection formula."""
    if x >= 1:
        return float(np.pi**2 / 6)
    if x > 0.5:
        return float(np.pi**2 / 6 - np.log(x) * np.log1p(-x)) - dilogarithm(1 - x)
    k = np.arange(1, 64)
    return float(np.sum(x**k / k**2))


def coverage(depth: float) -> float:
    """Ein(T) = ∫ (1 − e^−t) / t dt from 0 to T."""
    if depth > 8:
        return float(np.log(depth) + np.euler_gamma)  # E₁ is below 4e-5
    k = np.arange(1, 48)
    terms = np.cumprod(depth / k) / k
    return float(np.sum(np.where(k % 2 == 1, terms, -terms)))


def quat_from_matrix(matrix: Array) -> Array:
    """Unit quaternion wxyz, w ≥ 0, of a rotation matrix: the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    m = matrix
    K = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    quat = np.linalg.eigh(K)[1][:, -1]
    return np.asarray(quat if quat[0] >= 0 else -quat)
