"""Grow a part of a scene as it would grow within the whole, bit for bit.

A forest holds all nodes of a level whose mean is within a distance D of a box, and no other. Rows near the rim may have
neighbours that are not in the forest. So rows farther than D - r are *open*, and thinning has a third answer for them and for
what depends on them: *not certain* (kernels/reference/thin.py). Let u be the distance from the box to the nearest row whose
representative is not certain, or D - r if that is less. A group whose representative is nearer than u - r is complete, and its
merged mean is within r of the representative. So all nodes of the next level are known within the distance

    u - 2 r

They are kept and all others are dropped: the forest is again all nodes within a distance of the box. After the last level the
box owns the roots whose mean lies in the box, with all nodes below them. Boxes tile space, so each root of the whole scene has
one owner.

How far answers are uncertain depends on the scene: chains of neighbours carry uncertainty inwards, some 4 r in real scenes. Where
no distance is left, the part is too small and `TooNarrowError` says so. No answer is ever guessed.

Levels by pairs are chosen from the pairs of the whole scene, so they cannot grow in parts.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.build import thin as thin_kernel
from splatree.lod.forest import Base, Forest
from splatree.lod.grow_radius import level_of, question_of
from splatree.lod.order import Families
from splatree.lod.region import ROUNDING, Region
from splatree.lod.resolve import ResolvedBuild
from splatree.shapes import Array, Bool, Int32

__all__ = ["Owned", "TooNarrowError", "grow_region"]


class TooNarrowError(InputError):
    """What lies outside of a region could change what belongs to its box: load more around it."""


@dataclass(frozen=True, eq=False)
class Owned:
    """What belongs to a box."""

    forest: Forest
    """The roots whose mean is in the box, and all that is below them; base nodes are numbered in the order of their rank."""
    rows: Int32[Array, "n"]
    """Where each base node stood in the scene that growth began with."""
    counts: tuple[int, ...]
    """Nodes without a parent whose mean is in the box: at the beginning and after each size of levels."""


def grow_region(forest: Forest, resolved: ResolvedBuild, region: Region, *, num_levels: int, threads: int = 0) -> Owned:
    """Grow levels around a box, and keep what belongs to it.

    Args:
        forest: all nodes of the whole scene within ``region.reach`` of the box, and no other.
        resolved: what was decided for the whole scene; levels by a radius.
        region: the box, and how much around it is known.
        num_levels: sizes to go through.
        threads: threads to use; 0: all.

    Returns:
        The same nodes that growth of the whole scene gives the box, with the same bits.

    Raises:
        TooNarrowError: what is outside of the region could change them.
        InputError: levels are made by pairs.
    """
    if resolved.method != "radius":
        raise InputError("build in parts: found method 'pairs', which looks at all pairs of a scene; wanted 'radius'")
    box, reach = region.box, region.reach
    counts = [int(box.holds(forest.present.means).sum())]
    for radius in resolved.sizes_from(forest.num_sizes, num_levels):
        slack = Region(box, reach).slack
        distances = box.distances(forest.present.means)
        rim = reach - radius * (1 + ROUNDING) - slack
        representatives = _certain(forest, resolved, radius, distances > rim, threads)
        is_unsure = representatives < 0
        known = min(rim, float(distances[is_unsure].min(initial=np.inf)))
        reach = known - 2 * radius * (1 + ROUNDING) - slack
        if not reach >= 0:
            raise TooNarrowError(
                f"region: found {region.reach:g} world units known around the box, too few for radius {radius:g}"
            )
        representatives[is_unsure] = np.flatnonzero(is_unsure)  # dropped below
        forest = _with_level(forest, resolved, radius, representatives, threads)
        forest = _of_roots(forest, box.distances(forest.present.means) <= reach)
        counts.append(int(box.holds(forest.present.means).sum()))
    forest, rows = _below(_of_roots(forest, box.holds(forest.present.means)))
    return Owned(forest, rows, tuple(counts))


def _certain(forest: Forest, resolved: ResolvedBuild, radius: float, is_open: Array, threads: int) -> Array:
    columns, rules = question_of(forest, resolved, radius)
    return thin_kernel.certain(*columns, is_open, **rules, threads=threads)


def _with_level(forest: Forest, resolved: ResolvedBuild, radius: float, representatives: Array, threads: int) -> Forest:
    groups = thin_kernel.group(representatives)
    if len(groups) == len(forest.roots):
        return forest.skipped()
    return forest.with_level(level_of(forest, resolved, radius, groups, threads))


def _of_roots(forest: Forest, is_kept: Bool[Array, "r"]) -> Forest:
    """The forest with some of its roots; what was below the others stays among its nodes."""
    if is_kept.all():
        return forest
    return dataclasses.replace(
        forest,
        roots=forest.roots[is_kept],
        chains=forest.chains[is_kept],
        present=forest.present.take(is_kept),
        root_weights=forest.root_weights[is_kept],
        visibilities=None if forest.visibilities is None else forest.visibilities[is_kept],
    )


def _below(forest: Forest) -> tuple[Forest, Int32[Array, "n"]]:
    """The forest of the nodes at and below its roots alone, and the former places of its base nodes."""
    is_kept = np.zeros(len(forest), bool)
    is_kept[forest.roots] = True
    for level in reversed(forest.families):
        is_kept[level.children] |= np.repeat(is_kept[level.parents], level.fan_out)
    number = np.cumsum(is_kept, dtype=np.int32) - np.int32(1)
    num_base = len(forest.base.order)
    base_kept = is_kept[:num_base]
    families, sizes, counts = [], [], [int(base_kept.sum())]
    for level, size in zip(forest.families, forest.sizes, strict=True):
        of_family = is_kept[level.parents]
        if of_family.any():
            fan_out = level.fan_out[of_family]
            children = number[level.children[np.repeat(of_family, level.fan_out)]]
            extents = None if level.extents is None else level.extents[of_family]
            first = int(number[level.parents[of_family][0]])
            families.append(Families(first, children, np.cumsum(fan_out) - fan_out, extents))
            sizes.append(size)
            counts.append(counts[-1] - len(children) + len(fan_out))
    ends = np.cumsum([len(part) for part in forest.weights])[:-1]
    masks = np.split(is_kept, ends)
    base = forest.base
    reaches = None if base.reaches is None else base.reaches[base_kept]
    order = np.arange(counts[0], dtype=np.int32)
    kept = dataclasses.replace(
        forest,
        base=Base(order, base.codes[base_kept], base.inputs[base_kept], reaches),
        columns=tuple(part.take(mask) for part, mask in zip(forest.columns, masks, strict=True)),
        weights=tuple(part[mask] for part, mask in zip(forest.weights, masks, strict=True)),
        families=tuple(families),
        sizes=tuple(sizes),
        counts=tuple(counts),
        roots=number[forest.roots],
        chains=number[forest.chains],
    )
    return kept, base.order[base_kept]
