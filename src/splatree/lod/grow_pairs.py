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

Cost: neighbours are looked for once a level, by those that lost some (`build/partners.cpp`). Costs, a third of a microsecond
a Gaussian, are taken once a level in mode `classic` and where a partner has gone (`build/level.cpp`); where the pixel is that of
the level before, only by those whose candidates changed. Visibilities are measured once.
"""

import math

import numpy as np

from splatree.constants import PIXEL_ERROR
from splatree.kernels.cpu.build.thin import rows_by_group
from splatree.lod.forest import Forest, NewLevel
from splatree.lod.present import Present
from splatree.lod.region import Region
from splatree.lod.resolve import ResolvedBuild
from splatree.progress import task
from splatree.shapes import Array, Bool, Int32

__all__ = ["extent_of", "grow_by_pairs", "grow_part_by_pairs", "judged_at"]

JUDGED_POWER = 0.25
"""`classic`: the pixel of a level grows with this power of its size. At 1 tight budgets lose 1 to 2 dB (a city)."""

FLOAT32_MAX = float(np.finfo(np.float32).max)
"""The largest extent that a tree holds."""


def grow_by_pairs(
    forest: Forest, resolved: ResolvedBuild, *, num_levels: int | None = None, threads: int = 0
) -> Forest:
    """The forest with the levels of further pixel sizes, each merged as far as a view of that size does not show it.

    A root that has gone through more sizes than others waits until they have caught up, and holds up who would be merged with it.

    Args:
        forest: what has grown so far.
        resolved: what was decided for the whole scene.
        num_levels: sizes to go through; None: until at most ``max_roots`` nodes are left, or sizes end.
        threads: threads to use; 0: all.
    """
    present = Present.of(resolved, forest)
    fewest = resolved.max_roots if num_levels is None else 1
    with task("build levels", float(len(forest.roots))) as advance:
        for number, size in enumerate(resolved.sizes_from(forest.num_sizes, num_levels), forest.num_sizes):
            num_before = len(forest.roots)
            if num_before <= fewest and num_levels is None:
                break
            if num_before <= fewest:
                forest = forest.skipped()
                continue
            is_ahead = np.zeros(num_before, bool) if forest.grown is None else forest.grown > number
            present.search(threads)
            most = max(1, fewest - int(is_ahead.sum()))
            group_from_row = present.merge_level(
                size, judged_at(size, resolved), most, is_frozen=is_ahead, threads=threads
            )
            forest = forest.with_level(level_of(forest, present, group_from_row, is_ahead, size))
            advance(float(num_before - len(forest.roots)))
    return forest


def grow_part_by_pairs(
    forest: Forest,
    resolved: ResolvedBuild,
    region: Region,
    around: Forest,
    *,
    num_levels: int | None = None,
    fewest: int = 1,
    threads: int = 0,
) -> Forest:
    """The forest with levels of what a part can merge without a look beyond its border.

    What is around the part stays as it is. A root that would be merged with it waits: it goes through no further size, and growth
    above all parts takes it on from there, beside those across the border that waited for it. So does a root whose candidates
    reach beyond what is known, and who would be merged with one that waits: nobody takes a worse partner because of a border.

    Args:
        forest: all Gaussians of the scene in the box of the region.
        resolved: what was decided for the whole scene.
        region: the box of the part, and how much around it is known.
        around: the Gaussians of the scene around the box, as far as they are known.
        num_levels: sizes to go through; None: until few enough roots are left that do not wait, or sizes end.
        fewest: so few.
        threads: threads to use; 0: all.
    """
    present, waits = Present.of(resolved, forest, around), np.zeros(len(forest.roots), bool)
    are_around = np.ones(len(around.roots), bool)
    with task("build levels", float(len(waits))) as advance:
        for size in resolved.sizes_from(0, num_levels):
            num_before = len(waits)
            if num_before - waits.sum() <= fewest:
                break
            pixel_size = judged_at(size, resolved)
            present.search(threads)
            waits |= present.looks_out_of(region, num_before)
            is_frozen = present.with_held_up(np.append(waits, are_around), size, pixel_size, threads)
            group_from_row = present.merge_level(size, pixel_size, 1, is_frozen=is_frozen, threads=threads)[:num_before]
            waits = is_frozen[:num_before]
            forest = forest.with_level(level_of(forest, present, group_from_row, waits, size))
            waits = np.isin(np.arange(len(forest.roots)), group_from_row[waits])
            advance(float(num_before - len(waits)))
    return forest


def judged_at(size: float, resolved: ResolvedBuild) -> float:
    """Width of the pixel at which a level of that size is judged, world units; it counts in mode `classic` alone."""
    return resolved.judged_size * math.pow(max(1.0, size / resolved.judged_size), JUDGED_POWER)


def extent_of(size: float) -> np.float32:
    """The extent of a node that was made at a level of that size, world units."""
    return np.float32(min(PIXEL_ERROR * size, FLOAT32_MAX))


def level_of(
    forest: Forest, present: Present, group_from_row: Int32[Array, "r"], waits: Bool[Array, "r"], size: float
) -> NewLevel:
    """The level that merged the roots of a forest to the first rows that are present; those that wait do not go through it."""
    num_left = int(group_from_row.max(initial=-1)) + 1
    start, by_group = rows_by_group(group_from_row, num_left)
    representatives, grown = by_group[start[:-1]], None
    if waits.any() or forest.grown is not None:
        before = np.full(len(waits), forest.num_sizes, np.int32) if forest.grown is None else forest.grown
        grown = np.where(waits, before, np.int32(forest.num_sizes + 1))[representatives]
    return NewLevel(
        size=size,
        rows=by_group,
        start=start[:-1],
        representatives=representatives,
        merged=present.gaussians.rows(0, num_left),
        weights=present.weights[:num_left],
        visibilities=present.visibilities[:num_left],
        extents=np.full(num_left, extent_of(size)),
        grown=grown,
    )
