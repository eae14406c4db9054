"""The Gaussians that are left while levels grow by pairs, and what a level merges of them (lod/grow_pairs.py has the rules)."""

import dataclasses

import numpy as np

from splatree.constants import DILATION_PX2
from splatree.kernels.cpu.build.level import LevelLimits, find_partners, merge_level
from splatree.kernels.cpu.build.partners import Partners
from splatree.lod.forest import Forest
from splatree.lod.region import Region
from splatree.lod.resolve import ResolvedBuild
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.thinning import MergeOptions
from splatree.shapes import Array, Bool, Int32

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
    def of(resolved: ResolvedBuild, *forests: Forest) -> "Present":
        """The roots of forests, one forest after the other."""
        gaussians = Gaussians.concatenate([forest.present for forest in forests])
        weights = np.concatenate([forest.root_weights for forest in forests])
        visibilities = np.concatenate([forest.visibilities for forest in forests if forest.visibilities is not None])
        return Present(gaussians, weights, visibilities, resolved.mode, resolved.merge)

    def search(self, threads: int) -> None:
        """Look for new candidates of those that have lost more than a quarter of them: once a level."""
        self.partners.search(self.gaussians.means, threads=threads)

    def looks_out_of(self, region: Region, num_inside: int) -> Bool[Array, "_"]:
        """Which of the first rows, those in the box, have a candidate beyond what is known: others there may be nearer."""
        means = self.gaussians.means
        known = region.box.depths(means[:num_inside]) + region.reach
        return np.asarray(self.partners.reaches(means)[:num_inside] >= known)

    def with_held_up(
        self, is_frozen: Bool[Array, "n"], size: float, pixel_size: float, threads: int = 0
    ) -> Bool[Array, "n"]:
        """The frozen rows, and those that they hold up at a level of that size.

        A row is held up if its cheapest partner is frozen or held up, or if it is the cheapest partner of such a row, which costs
        no more than its own one.
        """
        limits = self._limits(size, pixel_size, 0)
        if self.is_classic:
            self.partners.renew(limits.dilation)
        find_partners(self.gaussians, self.weights, self.visibilities, self.partners, limits.dilation, threads=threads)
        partners, is_held = self.partners.rows, is_frozen.copy()
        may_merge = (partners >= 0) & (
            (self.partners.costs <= limits.cost) | (self.partners.least_sigmas <= limits.small_sigma)
        )
        costs = np.where(may_merge, self.partners.costs, np.inf)
        while True:
            asked = np.full(len(self), np.inf)
            asking = np.flatnonzero(is_held & may_merge)
            np.minimum.at(asked, partners[asking], costs[asking])
            found = ~is_held & ((may_merge & is_held[partners]) | ((asked < np.inf) & (asked <= costs)))
            if not found.any():
                return is_held
            is_held |= found

    def __len__(self) -> int:
        return len(self.gaussians)

    def merge_level(
        self, size: float, pixel_size: float, max_roots: int, *, is_frozen: Bool[Array, "n"], threads: int = 0
    ) -> Int32[Array, "n"]:
        """Merge what changes less than a level of that size allows, seen by pixels of that width; returns where each row went.

        Frozen rows stay as they are, and so does each row while its cheapest partner is one of them.
        """
        limits = self._limits(size, pixel_size, max_roots)
        if self.is_classic:
            self.partners.renew(limits.dilation)
        self.gaussians = Gaussians.concatenate([self.gaussians])  # a copy: others hold these
        self.weights, self.visibilities = self.weights.copy(), self.visibilities.copy()
        row_from_row = merge_level(
            *(self.gaussians, self.weights, self.visibilities, self.partners, self.merge),
            added=self.dilation_px2 * pixel_size**2,
            limits=limits,
            is_frozen=is_frozen,
            threads=threads,
        )
        is_left = row_from_row == np.arange(len(self), dtype=np.int32)
        self._keep(is_left, threads)
        number = np.cumsum(is_left, dtype=np.int32) - np.int32(1)
        return number[row_from_row]

    def _limits(self, size: float, pixel_size: float, max_roots: int) -> LevelLimits:
        width = np.float64(size)  # its square may be beyond float32
        return LevelLimits(
            cost=CHANGE * width**2,
            sigma=LARGE * max(size, pixel_size),
            small_sigma=SMALL * pixel_size if self.is_classic else -1.0,
            saturated=SATURATED if self.merge.opacity == "fitted" else 0.0,
            dilation=DILATION_PX2 * pixel_size**2 if self.is_classic else 0.0,
            round_share=ROUND_SHARE,
            last_share=LAST_SHARE,
            num_enough=max_roots,
        )

    def _keep(self, is_kept: Bool[Array, "n"], threads: int) -> None:
        self.gaussians = self.gaussians.take(is_kept)
        self.weights, self.visibilities = self.weights[is_kept], self.visibilities[is_kept]
        self.partners = self.partners.of_rows(is_kept, threads=threads)
