"""Partners that are kept from round to round: glue over partners.cpp.

The cost and the opacity of a pair are those of ``reference/pairs.py``. Candidates are the nearest rows at the time
of a search, later what these have become.
"""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.pairs import NUM_NEIGHBORS
from splatree.scene.gaussians import Gaussians
from splatree.scene.thinning import Groups
from splatree.shapes import Array, Bool, Float32, Int32, UInt8

__all__ = ["Partners"]

FEW = NUM_NEIGHBORS * 3 // 4
"""Candidates below which new ones are looked for, as in partners.cpp."""


@dataclass(eq=False)
class Partners:
    """Each row's cheapest partner among its neighbours: working memory that `find` fills in place, round after round."""

    neighbors: Int32[Array, "n c"]
    """Candidates of each row, −1 where there are fewer."""
    rows: Int32[Array, "n"]
    """Row of the partner; −1 if there is none."""
    costs: Float32[Array, "n"]
    """What merging them changes, squared, world units²; infinity if there is none."""
    opacities: Float32[Array, "n"]
    """Opacity of the two merged."""
    sigmas: Float32[Array, "n"]
    """Longest axis of the two merged, standard deviation in world units; infinity if there is none."""
    is_stale: UInt8[Array, "n"]
    """1 where the partner is to be found."""

    @classmethod
    def unknown(cls, n: int) -> "Partners":
        """Room for the partners of ``n`` rows, all to be found."""
        costs, opacities, sigmas = (np.empty(n, np.float32) for _ in range(3))
        neighbors = np.full((n, NUM_NEIGHBORS), -1, np.int32)
        return cls(neighbors, np.full(n, -1, np.int32), costs, opacities, sigmas, np.ones(n, np.uint8))

    def search(self, means: Float32[Array, "n 3"], *, threads: int = 0) -> None:
        """Look for new candidates, in place, of the rows that have lost more than a quarter of them; those are stale, too."""
        _core.find_neighbors(means, self, threads)

    def find(
        self,
        gaussians: Gaussians,
        weights: Float32[Array, "n"],
        visibilities: Float32[Array, "n"],
        *,
        dilation: float,
        threads: int = 0,
    ) -> None:
        """Find the partners that are stale, in place; ``dilation`` is added to every variance, world units²."""
        _core.find_partners(gaussians, weights, visibilities, dilation, self, threads)

    def reaches(self, means: Float32[Array, "n 3"]) -> Float32[Array, "n"]:
        """Distance of each row to its farthest candidate; infinity where candidates are missing."""
        farthest = np.zeros(len(means), np.float32)
        for others in self.neighbors.T:
            apart = means - means[others]
            np.maximum(farthest, np.einsum("ij,ij->i", apart, apart), out=farthest, where=others >= 0)
        farthest = np.sqrt(farthest)
        farthest[self.neighbors[:, FEW - 1] < 0] = np.inf
        return farthest

    def of_rows(self, is_kept: Bool[Array, "n"]) -> "Partners":
        """Those of some rows, without the others among their candidates."""
        number = np.where(is_kept, np.cumsum(is_kept) - 1, -1).astype(np.int32)
        number = np.append(number, np.int32(-1))  # which −1 leads to
        neighbors = number[self.neighbors[is_kept]]
        has_gap = (neighbors[:, :-1] < 0) & (neighbors[:, 1:] >= 0)
        rows = np.flatnonzero(has_gap.any(axis=1))
        order = np.argsort(neighbors[rows] < 0, axis=1, kind="stable")
        neighbors[rows] = np.take_along_axis(neighbors[rows], order, axis=1)
        partners = number[self.rows[is_kept]]
        is_stale = self.is_stale[is_kept] | (partners < 0)
        return Partners(
            neighbors, partners, self.costs[is_kept], self.opacities[is_kept], self.sigmas[is_kept], is_stale
        )

    def carried(self, pairs: Groups, means: Float32[Array, "g 3"], *, threads: int = 0) -> "Partners":
        """Those of the groups of one or two that the rows have become, with their ``means``.

        A partner stays until one of the two is merged. A merged Gaussian has the nearest of both members' neighbours.
        """
        carried = Partners.unknown(len(pairs))
        _core.carry_partners(pairs, means, self, carried, threads)
        return carried
