"""Sums over the leaves below each node of a tree: moments of mixtures, means of values, masses on the screen.

A node of a tree stands for the mixture of its leaves. Its mean and covariance follow from those of its children, level by level
from below, so that nothing cancels. The mass of a mixture at a dilation h is Σ w A(h), where A is the area of a Gaussian averaged
over views along its axes (lod/follow.py).

Cost: a few vectorised passes over each level.
"""

from collections.abc import Iterator

import numpy as np

from splatree.shapes import Array, Float64

__all__ = ["LeafSums", "areas"]


def areas(variances: Array, dilations: Array | float) -> Float64[Array, "n"]:
    """A(h) of Gaussians with these variances along their axes (n 3)."""
    a, b, c = np.sqrt(variances.T + np.asarray(dilations))
    return np.asarray((a * b + b * c + a * c) / 3)


class LeafSums:
    """Sums over the leaves below each row of a forest in preorder."""

    def __init__(self, subtree_end: Array, depth: Array) -> None:
        n = len(depth)
        self.is_leaf = np.asarray(subtree_end == np.arange(1, n + 1))
        """Whether each row is a leaf."""
        self._depth = depth
        before = np.concatenate([[0], np.cumsum(self.is_leaf)])
        self._first, self._end = before[:-1], before[subtree_end]  # leaves of each row
        self._rows = [np.flatnonzero(depth == level) for level in range(int(depth.max(initial=0)) + 1)]

    def moments(
        self, weights: Array, means: Array, covariances: Array
    ) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3 3"]]:
        """Mean and covariance of the mixture of each row's leaves, of which weights, means and covariances are given."""
        total, mixed, spreads = self._spread(weights), self._spread(means), self._spread(covariances)
        for rows, below, above, start in self._families():
            share = total[below]
            total[rows] = np.add.reduceat(share, start)
            mixed[rows] = np.add.reduceat(share[:, None] * mixed[below], start) / total[rows, None]
            apart = mixed[below] - mixed[above]
            spread = spreads[below] + apart[:, :, None] * apart[:, None, :]
            spreads[rows] = np.add.reduceat(share[:, None, None] * spread, start) / total[rows, None, None]
        return mixed, spreads

    def means(self, weights: Array, values: Array) -> Float64[Array, "n j"]:
        """Weighted mean of the values "l j" of each row's leaves."""
        total, mixed = self._spread(weights), self._spread(values)
        for rows, below, _, start in self._families():
            share = total[below]
            total[rows] = np.add.reduceat(share, start)
            mixed[rows] = np.add.reduceat(share[:, None] * mixed[below], start) / total[rows, None]
        return mixed

    def masses(
        self, inner: Array, weights: Array, variances: Array, dilations: Array
    ) -> tuple[Float64[Array, "i"], Float64[Array, "i"], Float64[Array, "i"]]:
        """Σ w, Σ w A(0) and Σ w A(h) of the leaves below rows of any depth, each of which has an h of its own.

        Cost: a pass over the leaves for each different h.
        """
        shown = np.empty(len(inner))
        for dilation in np.unique(dilations):
            chosen = np.flatnonzero(dilations == dilation)
            shown[chosen] = self._below(inner[chosen], weights * areas(variances, dilation))
        return self._below(inner, weights), self._below(inner, weights * areas(variances, 0.0)), shown

    def _spread(self, of_leaves: Array) -> Array:
        """Values of leaves at their rows, 0 at the others."""
        values = np.zeros((len(self._depth), *of_leaves.shape[1:]))
        values[self.is_leaf] = of_leaves
        return values

    def _families(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Level by level from below: rows with children, these children, the parent of each, where each family begins."""
        for above, below in zip(self._rows[-2::-1], self._rows[:0:-1], strict=True):
            parent = np.searchsorted(above, below) - 1
            start = np.flatnonzero(np.diff(parent, prepend=-1))
            yield above[parent[start]], below, above[parent], start

    def _below(self, rows: Array, values: Array) -> Float64[Array, "r"]:
        """Sum of the values of the leaves below each row; rows of one depth do not overlap, so each sum is of its own terms."""
        sums, padded = np.empty(len(rows)), np.append(values, 0.0)
        depths = self._depth[rows]
        for depth in np.unique(depths):
            at = np.flatnonzero(depths == depth)
            bounds = np.stack([self._first[rows[at]], self._end[rows[at]]], axis=1).ravel()
            sums[at] = np.add.reduceat(padded, bounds)[::2]
        return sums
