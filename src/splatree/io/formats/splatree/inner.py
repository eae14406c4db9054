"""Merged nodes as differences from what their leaves suggest: why a compact tree is hardly larger than its leaves.

A merged node nearly follows from its leaves: it is the mixture of them, weighted by opacity. The file holds the leaves, and of
each merged node how much it differs from that mixture, in quanta. Most codes are 0 or near it, and deflate packs them in two to
five bytes a node. Any tree can be written: a node that is nothing like its leaves has larger codes.

With μ', Σ' the mean and covariance of the mixture, R its axes and S its standard deviations (widened as the node's curve says,
lod/follow.py), a node has

    mean        μ = μ' + R max(S, max S / 256) a          a: three codes
    covariance  Σ = R S exp(B) S Rᵀ                       B: a symmetric matrix, six codes
    harmonics   those of the mixture + one code each
    curve       h = 2^code; g, m, n = those of leaves of these opacities, times powers of e
    opacity     min(g, 0.99), or 0 without a curve, + one code

Predictions are made from the leaves as the file holds them, so errors do not add up from level to level. Sums are in float64.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np

from splatree.constants import ALPHA_MAX, MERGED_LOG_SCALE_MAX
from splatree.io.opacities import opacities_from_logits
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.mixtures import LeafSums, areas
from splatree.maths.rotations import quats_from_matrices
from splatree.scene.gaussians import Gaussians
from splatree.scene.thinning import Weight
from splatree.shapes import Array, Float64

__all__ = ["NO_CURVE", "STEPS", "Inner", "Suggested", "inner_from_codes", "inner_of", "inner_to_codes", "suggested"]

STEPS = {
    "means": 1 / 32,
    "shapes": 0.05,
    "opacities": 1 / 255,
    "dc": 0.03,
    "harmonics": 0.03,
    "levels": 1 / 64,
    "curves": 0.03,
}
"""One quantum of each table: of ``means`` in standard deviations, of ``shapes`` in logarithms of variances, of ``dc`` and
``harmonics`` in their own units, of ``levels`` in octaves, of ``curves`` in natural logarithms."""

NO_CURVE = -(2**20)
"""Code of the level of a node that is drawn as stored, whose curve is four zeros."""

_LEAST_VARIANCE = 1e-24
"""Variances below it, world units², are taken for it."""

_TINY = 1e-37
"""Masses below it, world units², are taken for it: float32 ends there."""

_FLATTEST = 1 / 256
"""Differences of means are counted in standard deviations, but not in less than this share of the largest."""

_RATIO_MAX = 200.0
"""Logarithms of ratios beyond ± this are taken for it, so that no file leads to infinite covariances."""

_UPPER = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class Inner:
    """Merged nodes, in the order of their rows."""

    means: Float64[Array, "i 3"]
    """Means, world units."""
    covariances: Float64[Array, "i 3 3"]
    """Covariances, world units²."""
    opacities: Float64[Array, "i"]
    """Opacities, 0 to 1."""
    sh: Float64[Array, "i k 3"]
    """Harmonics, DC first."""
    curves: Float64[Array, "i 4"] | None
    """As `GaussianTree.curves`."""


@dataclass(frozen=True, eq=False)
class Suggested:
    """What leaves suggest for the nodes above them."""

    inner: Array
    """Rows of these nodes."""
    sums: LeafSums
    """Sums over the tree."""
    leaves: Gaussians
    """The leaves."""
    weights: Float64[Array, "l"]
    """What each leaf counts."""
    means: Float64[Array, "i 3"]
    """Means of the mixtures."""
    covariances: Float64[Array, "i 3 3"]
    """Covariances of the mixtures."""


def suggested(subtree_end: Array, depth: Array, leaves: Gaussians, weight: Weight) -> Suggested:
    """Prepare the sums over the leaves of a tree, weighted as its nodes were merged."""
    sums = LeafSums(subtree_end, depth)
    weights = np.maximum(opacities_from_logits(leaves.logit_opacities).astype(np.float64), 1e-12)
    if weight == "opacity-area":
        weights *= areas(_variances(leaves), 0.0)
    elif weight == "opacity-scale":
        weights *= np.sqrt(_variances(leaves)).mean(axis=1)
    spreads = covariances_from_gaussians(leaves.quats, _held(leaves.log_scales))
    inner = np.flatnonzero(~sums.is_leaf)
    means, covariances = sums.moments(weights, leaves.means, spreads)
    return Suggested(inner, sums, leaves, weights, means[inner], covariances[inner])


def inner_of(gaussians: Gaussians, curves: Array | None) -> Inner:
    """Merged nodes as what is coded of them."""
    return Inner(
        gaussians.means.astype(np.float64),
        covariances_from_gaussians(gaussians.quats, _held(gaussians.log_scales)),
        opacities_from_logits(gaussians.logit_opacities).astype(np.float64),
        gaussians.sh.astype(np.float64),
        None if curves is None else curves.astype(np.float64),
    )


def gaussians_of(inner: Inner) -> Gaussians:
    """Merged nodes as Gaussians again."""
    variances, axes = np.linalg.eigh(inner.covariances)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    opacities = np.clip(inner.opacities, 1e-6, 1 - 1e-6)
    columns = {
        "means": inner.means,
        "quats": quats_from_matrices(axes),
        "log_scales": 0.5 * np.log(np.maximum(variances, _LEAST_VARIANCE)),
        "logit_opacities": np.log(opacities) - np.log1p(-opacities),
        "sh": inner.sh,
    }
    with np.errstate(over="ignore"):  # the check of values finds what float32 does not hold
        return Gaussians(**{f.name: columns[f.name].astype(np.float32) for f in fields(Gaussians)})


def inner_to_codes(inner: Inner, by_leaves: Suggested) -> dict[str, Array]:
    """Differences from what the leaves suggest, in quanta; `packing.pack` rounds them."""
    tables: dict[str, Array] = {}
    curves = None
    if inner.curves is not None:
        exists = inner.curves[:, 3] > 0
        octaves = np.log2(np.where(exists, inner.curves[:, 3], 1)) / STEPS["levels"]
        tables["levels"] = np.where(exists, np.rint(octaves), NO_CURVE)[:, None]
        curves = _Curves(tables["levels"][:, 0], by_leaves)
        tables["curves"] = curves.to_codes(inner.curves)
        # What is decoded goes on, so that the reader widens by the same masses.
        decoded = curves.from_codes(np.rint(tables["curves"]))
    frame = _Frame.of(by_leaves, None if curves is None else decoded)
    tables["means"] = frame.inwards(inner.means - frame.means) / STEPS["means"]
    tables["shapes"] = frame.logarithms(inner.covariances)[:, *_UPPER] / STEPS["shapes"]
    expected = _opacities(None if curves is None else decoded, len(inner.means))
    tables["opacities"] = (inner.opacities - expected)[:, None] / STEPS["opacities"]
    for i in range(inner.sh.shape[1]):
        apart = inner.sh[:, i] - _harmonic(i, by_leaves)
        tables[f"sh{i}"] = apart / STEPS["dc" if i == 0 else "harmonics"]
    return tables


def inner_from_codes(tables: Mapping[str, Array], by_leaves: Suggested, steps: Mapping[str, float]) -> Inner:
    """The merged nodes of which `inner_to_codes` made the tables, with the quanta ``steps``."""
    curves = None
    if "levels" in tables:
        of_levels = _Curves(tables["levels"][:, 0], by_leaves, steps)
        curves = of_levels.from_codes(tables["curves"])
    frame = _Frame.of(by_leaves, curves)
    means = frame.means + frame.outwards(tables["means"] * steps["means"])
    logarithms = np.zeros((len(means), 3, 3))
    logarithms[:, *_UPPER] = tables["shapes"] * steps["shapes"]
    logarithms += np.triu(logarithms, 1).swapaxes(1, 2)
    opacities = _opacities(curves, len(means)) + tables["opacities"][:, 0] * steps["opacities"]
    k = by_leaves.leaves.sh.shape[1]
    sh = np.empty((len(means), k, 3))
    for i in range(k):
        sh[:, i] = _harmonic(i, by_leaves) + tables[f"sh{i}"] * steps["dc" if i == 0 else "harmonics"]
    return Inner(means, frame.covariances(logarithms), opacities, sh, curves)


def _harmonic(i: int, by_leaves: Suggested) -> Float64[Array, "i 3"]:
    """The coefficient i of the mixtures; one at a time, which bounds the memory."""
    return by_leaves.sums.means(by_leaves.weights, by_leaves.leaves.sh[:, i])[by_leaves.inner]


def _opacities(curves: Array | None, count: int) -> Float64[Array, "i"]:
    """What the curves say of opacities; 0 without them."""
    return np.zeros(count) if curves is None else np.minimum(curves[:, 2], ALPHA_MAX)


class _Curves:
    """Curves of nodes, whose levels are known, beside those of their leaves where nothing hides another."""

    def __init__(self, levels: Array, by_leaves: Suggested, steps: Mapping[str, float] = STEPS) -> None:
        self._exists = levels != NO_CURVE
        self._step = steps["curves"]
        octaves = np.where(self._exists, np.clip(levels * steps["levels"], -140.0, 120.0), 0)
        self._dilations = 2.0**octaves
        # Sums are taken at half octaves: few passes over the leaves, whatever a file says.
        near = 2.0 ** (np.rint(np.clip(octaves, -80, 80) * 2) / 2)
        sums, inner = by_leaves.sums, by_leaves.inner
        variances = _variances(by_leaves.leaves)
        alphas = opacities_from_logits(by_leaves.leaves.logit_opacities).astype(np.float64)
        far, bare, shown = sums.masses(inner, alphas, variances, near)
        own = np.maximum(np.linalg.eigvalsh(by_leaves.covariances), _LEAST_VARIANCE)
        self._bare, self._far, self._peak = (
            np.log(np.maximum(mass, _TINY)) for mass in (bare, far, shown / areas(own, near))
        )

    def to_codes(self, curves: Array) -> Float64[Array, "i 3"]:
        """The peak beside that of the leaves; what of the other two differs more or less than that."""
        bare, far, peak = (np.log(np.maximum(curves[:, i], _TINY)) for i in range(3))
        higher = peak - self._peak
        codes = np.stack([higher, bare - self._bare - higher, far - self._far - higher], axis=1) / self._step
        return np.where(self._exists[:, None], codes, 0)

    def from_codes(self, codes: Array) -> Float64[Array, "i 4"]:
        """Curves m, n, g, h."""
        higher, bare, far = np.clip(codes * self._step, -_RATIO_MAX, _RATIO_MAX).T
        logs = np.stack([self._bare + bare + higher, self._far + far + higher, self._peak + higher], axis=1)
        curves = np.column_stack([np.exp(np.minimum(logs, 80.0)), self._dilations])
        return np.where(self._exists[:, None], curves, 0)


@dataclass(frozen=True, eq=False)
class _Frame:
    """The mixtures: their means, axes R and standard deviations S."""

    means: Float64[Array, "i 3"]
    axes: Float64[Array, "i 3 3"]
    scales: Float64[Array, "i 3"]

    @staticmethod
    def of(by_leaves: Suggested, curves: Array | None) -> "_Frame":
        variances, axes = np.linalg.eigh(by_leaves.covariances)
        variances = np.maximum(variances, _LEAST_VARIANCE)
        if curves is not None:  # mass beyond one Gaussian widens the node (lod/follow.py)
            wide = np.maximum(curves[:, 2] / ALPHA_MAX, 1)[:, None] ** 0.3
            variances = wide * variances + (wide - 1) * curves[:, 3:]
        return _Frame(by_leaves.means, axes, np.sqrt(variances))

    @property
    def _units(self) -> Array:
        return np.asarray(np.maximum(self.scales, _FLATTEST * self.scales.max(axis=1, keepdims=True)))

    def inwards(self, apart: Array) -> Array:
        """Rᵀ x in standard deviations."""
        return np.asarray(np.einsum("nji,nj->ni", self.axes, apart) / self._units)

    def outwards(self, apart: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self.axes, apart * self._units))

    def logarithms(self, covariances: Array) -> Array:
        """B with exp(B) = S⁻¹ Rᵀ Σ R S⁻¹."""
        turned = self.axes.swapaxes(1, 2) @ covariances @ self.axes
        ratios = turned / self.scales[:, :, None] / self.scales[:, None, :]
        return _of_symmetric(lambda values: np.log(np.maximum(values, np.exp(-_RATIO_MAX))), ratios)

    def covariances(self, logarithms: Array) -> Array:
        """R S exp(B) S Rᵀ."""
        grown = _of_symmetric(lambda values: np.exp(np.clip(values, -_RATIO_MAX, _RATIO_MAX)), logarithms)
        turned = self.axes * self.scales[:, None, :]
        return np.asarray(turned @ grown @ turned.swapaxes(1, 2))


def _of_symmetric(function: Callable[[Array], Array], matrices: Array) -> Array:
    """A function of symmetric matrices, by their eigenvalues."""
    values, axes = np.linalg.eigh(matrices)
    return np.asarray((axes * function(values)[:, None, :]) @ axes.swapaxes(1, 2))


def _held(log_scales: Array) -> Float64[Array, "n 3"]:
    return np.clip(log_scales, -MERGED_LOG_SCALE_MAX, MERGED_LOG_SCALE_MAX).astype(np.float64)


def _variances(g: Gaussians) -> Float64[Array, "n 3"]:
    return np.asarray(np.exp(2 * _held(g.log_scales)))
