"""What leaves show at the pixels of all levels, added up to the nodes above them: merged Gaussians follow the pixel above parts.

Where a merged Gaussian follows the pixel that it is drawn at, its curve is a sum over all of its leaves at the pixel of its level
(lod/follow.py). Above parts the leaves are elsewhere. But levels have few sizes, which are known beforehand. So a part writes for
each of its roots what the leaves below it show at the pixel of every level, and the moments of these leaves:

    Σ α A(h), Σ α v A(h) for each dilation h,     Σ α, Σ α v, their mean and covariance with the weights α v

All of this adds up from children to parents, so a node above parts has the curve that its leaves give it. Covariances are added
around the means of parts, so that nothing cancels. The equations are those of kernels/reference/curves.py.

Cost: 0.1 processor seconds a million leaves. 14 + 2 d float64 for each root and node, d ≤ 30 dilations, lie in a file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from splatree.constants import ALPHA_MAX, DILATION_PX2, MERGED_LOG_SCALE_MAX
from splatree.kernels.reference.curves import LARGEST, LEAST_OPACITY, LEAST_VARIANCE, LEAST_WEIGHT, WIDENING, areas
from splatree.lod.follow import dilations_of_extents, kept_extent
from splatree.lod.grow_pairs import extent_of
from splatree.lod.order import Families
from splatree.lod.resolve import ResolvedBuild
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.rotations import quats_from_matrices
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int64, check_fields

__all__ = ["NODES_AT_A_TIME", "Shown", "dilations_of", "fit_shown", "num_columns", "shown_above", "shown_of_leaves"]

NODES_AT_A_TIME = 1 << 15
"""Nodes whose numbers are in memory together, 600 bytes each; those of all others may lie in a file."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What the leaves below some nodes are together, and what they show."""

    alphas: Float64[Array, "n"]
    """Σ α."""
    weights: Float64[Array, "n"]
    """Σ α v."""
    means: Float64[Array, "n 3"]
    """Their mean with the weights α v, world units."""
    covariances: Float64[Array, "n 3 3"]
    """Covariance of their mixture with these weights, world units²."""
    alpha_masses: Float64[Array, "n d"]
    """Σ α A(h) at each of `dilations_of`, world units²."""
    weight_masses: Float64[Array, "n d"]
    """Σ α v A(h), world units²."""

    def __post_init__(self) -> None:
        check_fields(self)

    def added(self, start: Int64[Array, "g"]) -> "Shown":
        """Of groups of nodes that follow each other; ``start`` is the first of each."""

        def sums(each: Array) -> Array:
            return np.add.reduceat(each, start, axis=0)

        weights = sums(self.weights)
        group = np.repeat(np.arange(len(start)), np.diff(start, append=len(self.weights)))
        means = sums(self.weights[:, None] * self.means) / weights[:, None]
        apart = self.means - means[group]
        shares = self.weights / weights[group]
        covariances = sums(shares[:, None, None] * (self.covariances + apart[:, :, None] * apart[:, None]))
        masses = sums(self.alpha_masses), sums(self.weight_masses)
        return Shown(sums(self.alphas), weights, means, covariances, *masses)

    def columns(self) -> Float64[Array, "n c"]:
        """All numbers of a node as a row, for a file."""
        return np.concatenate([getattr(self, f.name).reshape(len(self.alphas), -1) for f in fields(self)], axis=1)

    @staticmethod
    def of_columns(columns: Float64[Array, "n c"]) -> "Shown":
        """What `columns` made a row of each."""
        num_masses = (columns.shape[1] - 14) // 2
        parts = np.split(columns, np.cumsum([1, 1, 3, 9, num_masses]), axis=1)
        alphas, weights, means, covariances, *masses = map(np.ascontiguousarray, parts)
        return Shown(alphas[:, 0], weights[:, 0], means, covariances.reshape(-1, 3, 3), *masses)


def dilations_of(resolved: ResolvedBuild) -> Float64[Array, "d"]:
    """The variances that pixels add, world units², ascending: none, that of the pixel p_0, and that of each level by pairs."""
    extents = np.array([extent_of(size) for size in resolved.sizes()])
    stored = dilations_of_extents(extents, resolved.stored_size)
    return np.unique(np.concatenate([[0.0, _kept_dilation(resolved)], stored]))


def num_columns(resolved: ResolvedBuild) -> int:
    """Numbers of a node: `Shown.columns`."""
    return 14 + 2 * len(dilations_of(resolved))


def shown_of_leaves(
    leaves: Gaussians, seen: Float32[Array, "n"], start: Int64[Array, "g"], resolved: ResolvedBuild
) -> Shown:
    """What groups of leaves show together.

    Args:
        leaves: the leaves below one root after the other.
        seen: visibility of each, 0 to 1.
        start: the first leaf of each root.
        resolved: what was decided for the whole scene; levels by pairs.
    """
    log_scales = np.minimum(leaves.log_scales.astype(np.float64), MERGED_LOG_SCALE_MAX)
    variances, alphas = np.exp(2 * log_scales), leaves.opacities().astype(np.float64)
    weights = np.maximum(alphas * seen, LEAST_WEIGHT)
    dilations = dilations_of(resolved)
    masses = np.empty((2, len(start), len(dilations)))
    for i, dilation in enumerate(dilations):
        shown = areas(variances, dilation)
        for mass, factors in zip(masses, (alphas, weights), strict=True):
            mass[:, i] = np.add.reduceat(factors * shown, start)
    nothing = np.empty((len(leaves), 0))
    covariances = covariances_from_gaussians(leaves.quats, log_scales)
    moments = Shown(alphas, weights, leaves.means.astype(np.float64), covariances, nothing, nothing).added(start)
    return Shown(moments.alphas, moments.weights, moments.means, moments.covariances, *masses)


def shown_above(columns: Float64[Array, "n c"], families: Sequence[Families]) -> None:
    """Fill in what the leaves of new nodes show, from the finest level up; the nodes which growth began with are there.

    Args:
        columns: what the leaves of each node show (`Shown.columns`); may be mapped from a file.
        families: the nodes of each level, and their children.
    """
    for level in families:
        ends = np.append(level.start[1:], len(level.children))
        first = 0
        while first < len(ends):
            last = max(first + 1, int(np.searchsorted(ends, level.start[first] + NODES_AT_A_TIME, side="right")))
            start = level.start[first:last] - level.start[first]
            children = level.children[level.start[first] : ends[last - 1]]
            columns[level.parents[first:last]] = Shown.of_columns(columns[children]).added(start).columns()
            first = last


def fit_shown(
    gaussians: Gaussians, extents: Float32[Array, "n"], shown: Shown, resolved: ResolvedBuild
) -> tuple[Gaussians, Float32[Array, "n 4"]]:
    """Merged nodes that follow the pixel they are drawn at, and their curves: m, n, g, h_l.

    Args:
        gaussians: the nodes as they were merged.
        extents: their extents, world units.
        shown: what their leaves show.
        resolved: what was decided for the whole scene; levels by pairs.
    """
    dilations = dilations_of(resolved)

    def mass(places: Array) -> Array:
        rows = np.arange(len(extents))
        return np.asarray(np.sqrt(shown.alpha_masses[rows, places] * shown.weight_masses[rows, places]))

    own, axes = np.linalg.eigh(shown.covariances)
    own, axes = np.maximum(own[:, ::-1], LEAST_VARIANCE), axes[:, :, ::-1]  # the longest first
    axes = axes * np.stack([*np.ones((2, len(axes))), np.sign(np.linalg.det(axes))], axis=1)[:, None]
    means, quats = shown.means.astype(np.float32), quats_from_matrices(axes).astype(np.float32)
    scale = np.ones(len(extents))
    keeps = extents <= kept_extent(resolved.judged_size)
    if keeps.any():
        kept = gaussians.take(np.flatnonzero(keeps))
        variances = np.exp(2 * np.minimum(kept.log_scales.astype(np.float64), MERGED_LOG_SCALE_MAX))
        own[keeps] = np.maximum(variances, LEAST_VARIANCE)
        means[keeps], quats[keeps] = kept.means, kept.quats
        dilation = _kept_dilation(resolved)
        alphas = np.minimum(kept.opacities().astype(np.float64), ALPHA_MAX)
        shows = mass(np.full(len(extents), np.searchsorted(dilations, dilation)))[keeps]
        scale[keeps] = alphas * areas(own[keeps], dilation) / shows
    h = dilations_of_extents(extents, resolved.stored_size)
    drawn = scale * mass(np.searchsorted(dilations, h)) / areas(own, h[:, None])
    wide = np.maximum(drawn / ALPHA_MAX, 1.0) ** WIDENING
    opacities = np.clip(drawn, LEAST_OPACITY, ALPHA_MAX)
    log_scales = np.minimum(np.log(wide[:, None] * own + ((wide - 1) * h)[:, None]) / 2, MERGED_LOG_SCALE_MAX)
    logits = np.log(opacities) - np.log1p(-opacities)
    bare, far = mass(np.zeros(len(extents), np.intp)), np.sqrt(shown.alphas * shown.weights)
    curves = np.stack([scale * bare, scale * far, drawn, h], axis=1)
    curves[~(curves.max(axis=1, initial=0) < LARGEST)] = 0
    columns = (log_scales.astype(np.float32), logits.astype(np.float32))
    return Gaussians(means, quats, *columns, gaussians.sh), curves.astype(np.float32)


def _kept_dilation(resolved: ResolvedBuild) -> float:
    return DILATION_PX2 * resolved.judged_size**2
