"""Partners that are kept from level to level: glue over partners.cpp.

The cost and the opacity of a pair are those of ``reference/pairs.py``. Candidates are the nearest rows at the time
of a search, later what these have become.
"""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.pairs import NUM_NEIGHBORS
from splatree.shapes import Array, Bool, Float32, Int32, UInt8

__all__ = ["FOUND", "OUTDATED", "STALE", "Partners"]

FEW = NUM_NEIGHBORS * 3 // 4
"""Candidates below which new ones are looked for, as in partners.cpp."""

FOUND, OUTDATED, STALE = range(3)
"""How much of what is known of a row's partner still holds: `states`."""


@dataclass(eq=False)
class Partners:
    """Each row's cheapest partner among its neighbours: working memory that `merge_level` fills in place, round after round."""

    neighbors: Int32[Array, "n c"]
    """Candidates of each row, −1 where there are fewer."""
    rows: Int32[Array, "n"]
    """Row of the partner; −1 if there is none."""
    costs: Float32[Array, "n"]
    """What merging them changes, squared, world units²; infinity if there is none."""
    opacities: Float32[Array, "n"]
    """Opacity of the two merged."""
    least_sigmas: Float32[Array, "n"]
    """The longest axis of the two merged, standard deviation in world units, is no shorter; infinity if there is none."""
    states: UInt8[Array, "n"]
    """`FOUND` where the partner is the cheapest of the candidates, `OUTDATED` where it was until others of them were merged,
    `STALE` where it is to be found."""
    dilation: float | None = None
    """Variance that was added to every axis when `renew` was called last, world units²."""

    @classmethod
    def unknown(cls, n: int) -> "Partners":
        """Room for the partners of ``n`` rows, all to be found."""
        costs, opacities, least_sigmas = (np.empty(n, np.float32) for _ in range(3))
        neighbors = np.full((n, NUM_NEIGHBORS), -1, np.int32)
        return cls(neighbors, np.full(n, -1, np.int32), costs, opacities, least_sigmas, np.full(n, STALE, np.uint8))

    def search(self, means: Float32[Array, "n 3"], *, threads: int = 0) -> None:
        """Look for new candidates, in place, of the rows that have lost more than a quarter of them; those are stale, too."""
        _core.find_neighbors(means, self, threads)

    def renew(self, dilation: float) -> None:
        """Find the partners anew, as costs with that dilation say; those that would be found again stay."""
        self.states[self.states != FOUND if dilation == self.dilation else slice(None)] = STALE
        self.dilation = dilation

    def reaches(self, means: Float32[Array, "n 3"]) -> Float32[Array, "n"]:
        """Distance of each row to its farthest candidate; infinity where candidates are missing."""
        farthest = np.zeros(len(means), np.float32)
        for others in self.neighbors.T:
            apart = means - means[others]
            np.maximum(farthest, np.einsum("ij,ij->i", apart, apart), out=farthest, where=others >= 0)
        farthest = np.sqrt(farthest)
        farthest[self.neighbors[:, FEW - 1] < 0] = np.inf
        return farthest

    def of_rows(self, is_kept: Bool[Array, "n"], *, threads: int = 0) -> "Partners":
        """Those of some rows, without the others among their candidates."""
        kept = Partners.unknown(int(np.count_nonzero(is_kept)))
        kept.dilation = self.dilation
        _core.keep_partners(is_kept.view(np.uint8), self, kept, threads)
        return kept
