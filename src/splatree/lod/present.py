"""The Gaussians that are left while levels grow by pairs, and what a level merges of them (lod/grow_pairs.py has the rules)."""

import dataclasses
from copy import copy

import numpy as np

from splatree.constants import DILATION_PX2
from splatree.kernels.cpu.build.level import LevelLimits, merge_level
from splatree.kernels.cpu.build.partners import Partners
from splatree.lod.forest import Forest
from splatree.lod.region import EVERYWHERE, Box
from splatree.lod.resolve import ResolvedBuild
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.thinning import MergeOptions
from splatree.shapes import Array, Bool, Int64

__all__ = ["Present"]

CHANGE = 0.1
"""ε: squared change of the picture that one merge may make, s², summed over colours and coverage and three views."""

SMALL = 0.68
"""`classic`: a merged Gaussian of at most this standard deviation, in pixels p, is merged whatever the change."""

LARGE = 16.0
"""A merged Gaussian of a larger standard deviation waits for a larger level, in units of s or p, whichever is wider."""

SATURATED = 0.98
"""A fitted opacity from here on says that more is shown than one Gaussian can; the merge's own rule follows."""

ROUND_SHARE = 0.25
"""Pairs that a round merges at most, as a share of the Gaussians: those cheapest to merge twice get their turn."""

LAST_SHARE = 0.01
"""A round that merges a smaller share is a level's last."""


class Present:
    """The Gaussians that are left of a scene, and each one's cheapest partner."""

    def __init__(
        self, gaussians: Gaussians, weights: Array, visibilities: Array, mode: Mode, merge: MergeOptions
    ) -> None:
        """``merge`` resolved."""
        self.gaussians, self.weights, self.visibilities = gaussians, weights, visibilities
        self.is_classic = mode == "classic"
        self.dilation_px2, self.merge = merge.dilation or 0.0, dataclasses.replace(merge, dilation=0.0)
        self.partners = Partners.unknown(len(gaussians))

    @staticmethod
    def of(forest: Forest, resolved: ResolvedBuild, rows: Int64[Array, "p"]) -> "Present":
        """Some roots of a forest, by their place among them, ascending."""
        assert forest.visibilities is not None
        columns = forest.present.take(rows), forest.root_weights[rows], forest.visibilities[rows]
        return Present(*columns, resolved.mode, resolved.merge)

    def of_rows(self, is_kept: Bool[Array, "n"], threads: int) -> "Present":
        """Some of them, with what is known of their partners."""
        if is_kept.all():
            return self
        kept = copy(self)
        kept._keep(is_kept, threads)
        return kept

    def search(self, threads: int) -> None:
        """Look for new candidates of those that have lost more than a quarter of them: once a level."""
        self.partners.search(self.gaussians.means, threads=threads)

    def looks_out_of(self, box: Box) -> Bool[Array, "n"]:
        """Which of them have a candidate that is as far as a side of the box: what lies beyond may be nearer."""
        means = self.gaussians.means
        return np.asarray((self.partners.reaches(means) >= box.depths(means)) & (box != EVERYWHERE))

    def __len__(self) -> int:
        return len(self.gaussians)

    def merge_level(self, size: float, pixel_size: float, max_roots: int, threads: int) -> Array:
        """Merge what changes less than a level of that size allows, seen by pixels of that width; returns where each row went."""
        width = np.float64(size)  # its square may be beyond float32
        limits = LevelLimits(
            cost=CHANGE * width**2,
            sigma=LARGE * max(size, pixel_size),
            small_sigma=SMALL * pixel_size if self.is_classic else -1.0,
            saturated=SATURATED if self.merge.opacity == "fitted" else 0.0,
            dilation=DILATION_PX2 * pixel_size**2 if self.is_classic else 0.0,
            round_share=ROUND_SHARE,
            last_share=LAST_SHARE,
            num_enough=max_roots,
        )
        if self.is_classic:
            self.partners.renew(limits.dilation)
        self.gaussians = Gaussians.concatenate([self.gaussians])  # a copy: others hold these
        self.weights, self.visibilities = self.weights.copy(), self.visibilities.copy()
        row_from_row = merge_level(
            *(self.gaussians, self.weights, self.visibilities, self.partners, self.merge),
            added=self.dilation_px2 * pixel_size**2,
            limits=limits,
            threads=threads,
        )
        is_left = row_from_row == np.arange(len(self), dtype=np.int32)
        self._keep(is_left, threads)
        number = np.cumsum(is_left, dtype=np.int32) - np.int32(1)
        return number[row_from_row]

    def _keep(self, is_kept: Bool[Array, "n"], threads: int) -> None:
        self.gaussians = self.gaussians.take(is_kept)
        self.weights, self.visibilities = self.weights[is_kept], self.visibilities[is_kept]
        self.partners = self.partners.of_rows(is_kept, threads=threads)
