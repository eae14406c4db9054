"""Levels by pairs: for each width of a pixel, the merges that such a pixel does not show.

Level l has the size s_l = s_0 g^l, world units. Two Gaussians may become one if their merging changes the picture by at most
E ≤ ε s_l², ε = 0.1, in squared signal (kernels/reference/pairs.py has E), the cheapest pairs first and each Gaussian with its
cheapest partner, round after round until few are left. Gaussians that became one are a family. The nodes of a level stand for
their leaves wherever a pixel is s_l or wider: their extent is e = τ_R s_l, so that the profile `pixel`,
R = f e / distance ≤ τ_R, draws them from there on. Large even surfaces are merged early and small details late, whatever
their size; all cuts are near the one with the fewest nodes for its squared error.

In mode `classic` each splat grows by 0.3 px². So does each Gaussian here before costs are computed and areas compared, by the
pixel p_l at which the level is *judged*:

    p_l = p_0 max(1, s_l / p_0)^¼,     p_0 = 4 s_0: a third of the median Gaussian

Levels finer than p_0 are judged at p_0: they merge what changes next to nothing. Levels coarser than p_0 are judged at a finer
pixel than their size, for a budget draws them there. Judged at their own size, they would blur away
what such a pixel shows before costs are taken (docs/explanation/build.md, "The pixel of a level").

Where the dilation dominates, many opaque splats share a pixel. The picture is saturated there, and sums of signals overstate what
is seen. So a node that is smaller than a pixel, σ ≤ 0.68 p, is merged whatever the cost. `fitted` opacities are taken below 0.98,
above it those of the rule `standard`, which widens what is opaque already.

Hidden Gaussians count less (simplify/visibility.py), in the costs and in the look of the merged node.

A node is at most 16 s long (σ), or 16 p where that is more. Seen with a focal length of 550 px it then ends within a tenth of the
distance, and one width of a pixel is true of all of it.

Cost: neighbours are looked for once a level, by those that lost some (`build/partners.cpp`); costs, about half a microsecond
a Gaussian, once a level in mode `classic` and where a partner has gone; visibilities once.
"""

import dataclasses
import math

import numpy as np

from splatree.constants import DILATION_PX2, PIXEL_ERROR
from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.build.pairs import match_pairs
from splatree.kernels.cpu.build.partners import Partners
from splatree.kernels.cpu.build.thin import group, rows_by_group
from splatree.lod.forest import Forest, NewLevel
from splatree.lod.resolve import ResolvedBuild
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.thinning import Groups, MergeOptions
from splatree.shapes import Array
from splatree.simplify.pairs import means_of_pairs

__all__ = ["Present", "grow_by_pairs"]

CHANGE = 0.1
"""ε: squared change of the picture that one merge may make, s², summed over colours and coverage and three views."""

JUDGED_POWER = 0.25
"""`classic`: the pixel of a level grows with this power of its size. At 1 tight budgets lose 1 to 2 dB (a city)."""

SMALL = 0.68
"""`classic`: a merged Gaussian of at most this standard deviation, in pixels p, is merged whatever the change."""

LARGE = 16.0
"""A merged Gaussian of a larger standard deviation waits for a larger level, in units of s or p, whichever is wider."""

SATURATED = 0.98
"""A fitted opacity from here on says that more is shown than one Gaussian can; the merge's own rule follows."""

FLOAT32_MAX = float(np.finfo(np.float32).max)
"""The largest extent that a tree holds."""

ROUND_SHARE = 0.25
"""Pairs that a round merges at most, as a share of the Gaussians: those cheapest to merge twice get their turn."""

LAST_SHARE = 0.01
"""A round that merges a smaller share is a level's last."""


def grow_by_pairs(
    forest: Forest, resolved: ResolvedBuild, *, num_levels: int | None = None, threads: int = 0
) -> Forest:
    """The forest with the levels of further pixel sizes, each merged as far as a view of that size does not show it.

    Args:
        forest: what has grown so far.
        resolved: what was decided for the whole scene.
        num_levels: sizes to go through; None: until at most ``max_roots`` nodes are left, or sizes end.
        threads: threads to use; 0: all.
    """
    present = Present.of(forest, resolved)
    fewest = resolved.max_roots if num_levels is None else 1
    with task("build levels", float(len(present))) as advance:
        for size in resolved.sizes_from(forest.num_sizes, num_levels):
            num_before = len(present)
            if num_before <= fewest and num_levels is None:
                break
            if num_before <= fewest:
                forest = forest.skipped()
                continue
            group_from_row = present.merge_level(size, judged_at(size, resolved), fewest, threads)
            start, rows = rows_by_group(group_from_row, len(present))
            level = NewLevel(
                size=size,
                rows=rows,
                start=start[:-1],
                representatives=rows[start[:-1]],
                merged=present.gaussians,
                weights=present.weights,
                visibilities=present.visibilities,
                extents=np.full(len(present), min(PIXEL_ERROR * size, FLOAT32_MAX), np.float32),
            )
            forest = forest.with_level(level)
            advance(float(num_before - len(present)))
    return forest


def judged_at(size: float, resolved: ResolvedBuild) -> float:
    """Width of the pixel at which a level of that size is judged, world units; it counts in mode `classic` alone."""
    return resolved.judged_size * math.pow(max(1.0, size / resolved.judged_size), JUDGED_POWER)


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
    def of(forest: Forest, resolved: ResolvedBuild) -> "Present":
        """The roots of a forest."""
        assert forest.visibilities is not None
        return Present(forest.present, forest.root_weights, forest.visibilities, resolved.mode, resolved.merge)

    def __len__(self) -> int:
        return len(self.gaussians)

    def merge_level(self, size: float, pixel_size: float, max_roots: int, threads: int) -> Array:
        """Merge what changes less than a level of that size allows, seen by pixels of that width; returns where each row went."""
        if self.is_classic:
            self.partners.is_stale[:] = 1  # costs are those of dilated Gaussians
        group_from_row = np.arange(len(self), dtype=np.int32)
        search = True
        while len(self) > max_roots:
            pairs = self._match(size, pixel_size, search, threads)
            num_merged = len(self) - len(pairs)
            if num_merged:
                self._merge(pairs, pixel_size, threads)
                group_from_row = pairs.group_from_row[group_from_row]
            if num_merged < LAST_SHARE * len(self):
                break
            search = False
        return group_from_row

    def _match(self, size: float, pixel_size: float, search: bool, threads: int) -> Groups:
        dilation = DILATION_PX2 * pixel_size**2 if self.is_classic else 0.0
        partners = self.partners
        partners.find(
            self.gaussians, self.weights, self.visibilities, dilation=dilation, search=search, threads=threads
        )
        width = np.float64(size)  # its square may be beyond float32
        allowed = (partners.costs <= CHANGE * width**2) & (partners.sigmas <= LARGE * max(size, pixel_size))
        if self.is_classic:
            allowed |= partners.sigmas <= SMALL * pixel_size
        rows = np.where(allowed, partners.rows, np.int32(-1))
        return group(match_pairs(rows, partners.costs, int(ROUND_SHARE * len(self)) + 1, threads=threads))

    def _merge(self, pairs: Groups, pixel_size: float, threads: int) -> None:
        opacities = None
        if self.merge.opacity == "fitted":
            fitted = self.partners.opacities[pairs.representatives]
            opacities = np.where(fitted < SATURATED, fitted, np.float32(0))
        self.gaussians = merge_kernel.merge(
            *(self.gaussians, pairs, self.weights, self.merge),
            added=self.dilation_px2 * pixel_size**2,
            opacities=opacities,
            threads=threads,
        )
        self.visibilities = means_of_pairs(self.visibilities, pairs, self.weights)
        self.weights = np.add.reduceat(self.weights[pairs.rows], pairs.start[:-1])
        self.partners = self.partners.carried(pairs, self.gaussians.means, threads=threads)
