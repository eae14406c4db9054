"""Levels by a radius: each thins the one before with a radius that is g times as large.

A group of two or more becomes a new node with its members as children. A group of one moves up itself, so no node has a single
child. Weights are summed upwards, so means, covariances and colours of a node are those of its leaves. Harmonics above DC play no
part in the grouping; `assemble` averages them at the end.

In mode `classic`, where visibilities are known, a Gaussian joins a representative only if this changes the picture by at most

    E ≤ ε r² (r / r_0)^¼,     ε = 0.06

in squared signal (kernels/reference/pairs.py has E, here without a dilation). What others hide changes little, so it joins
first. By distance alone, cuts of 80 % of the leaves from afar lost up to 8 dB to a static set, which merges first what changes
nothing. The limit grows a little faster than a pixel's area, and colours count less from level to level, ρ_l = ρ √(r / r_0):
coarse levels have to merge what differs. The last level, whose radius passes the scene's diagonal, has no limit.

Nodes are drawn level by level, by the profile `pixel`. A node of the level of radius r, with the standard deviation σ along its
longest axis, has the extent

    e = 2 r g^(t / 2√(1 + t²)),     t = ½ log_g(1.5 σ / r)

which lies between 2 r / √g and 2 r √g. So extents grow up the tree, and within a level large nodes are drawn from farther away.
Drawn by their size on the screen alone, nodes of all levels came in one order, and a wide flat node, which changes little, came
after a small one of a coarser level, which changes much: cuts lost up to 11 dB (docs/explanation/build.md).

Cost: a thinning and a merge a level, the levels together two to four times the leaves; with a limit half a microsecond more for
each Gaussian of a level.
"""

import math
from typing import TypedDict

import numpy as np

from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.build import thin as thin_kernel
from splatree.lod.forest import Forest, NewLevel
from splatree.lod.resolve import ResolvedBuild
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.thinning import Groups, MergeLimit
from splatree.shapes import Array, Float32
from splatree.simplify.merge import importance_of
from splatree.simplify.thin import linear_colors

__all__ = ["extents_of", "grow_by_radius", "level_of", "question_of"]

DRAWN = 2.0
"""The extent of a usual node, in radii of its level: at τ_R = 3 px it is drawn from a pixel of ⅔ r on. A city's cut at 3 px is
then as near to the leaves as by pairs."""

USUAL = 1.5
"""A usual node has a radius of so many of its standard deviations."""

SPREAD = 0.25
"""Extents within a level grow with this power of the nodes' size, at first. At 0 all nodes of a level switch together: the worst
pop of a city is at 52.6 dB in place of 53.9, and levels of a stream come in steps. At ½ a logo from afar loses 0.8 dB to a static
set."""


CHANGE = 0.06
"""ε at the first level: at 0.1 a biker at 80 % from outside loses 0.7 dB, at 0.04 a logo from afar 2 dB."""

CHANGE_POWER = 0.25
"""ε grows with this power of the radius: at 0 cuts of 2 % lose 0.2 to 0.7 dB, and a biker has 5 % more nodes."""

COLOR_POWER = 0.5
"""The distance in colour that counts as much as the radius grows with this power of it: at 0 cuts of 2 % lose 0.5 dB."""


def grow_by_radius(
    forest: Forest, resolved: ResolvedBuild, *, num_levels: int | None = None, threads: int = 0
) -> Forest:
    """The forest with the levels of further radii.

    Args:
        forest: what has grown so far.
        resolved: what was decided for the whole scene.
        num_levels: radii to go through; None: until at most ``max_roots`` nodes are left, or radii end.
        threads: threads to use; 0: all.
    """
    with task("build levels", float(len(forest.roots))) as advance:
        for radius in resolved.sizes_from(forest.num_sizes, num_levels):
            if num_levels is None and len(forest.roots) <= resolved.max_roots:
                break
            if len(forest.roots) < 2:
                forest = forest.skipped()
                continue
            columns, rules = question_of(forest, resolved, radius)
            groups = thin_kernel.thin(*columns, **rules, threads=threads)
            advance(float(len(forest.roots) - len(groups)))
            if len(groups) == len(forest.roots):
                forest = forest.skipped()
                continue
            forest = forest.with_level(level_of(forest, resolved, radius, groups, threads))
    return forest


def level_of(forest: Forest, resolved: ResolvedBuild, radius: float, groups: Groups, threads: int) -> NewLevel:
    """The level that makes one node of each of these groups of the roots of a forest."""
    merged = merge_kernel.merge(forest.present, groups, forest.root_weights, resolved.merge, threads=threads)
    weights = np.add.reduceat(forest.root_weights[groups.rows], groups.start[:-1])
    visibilities = forest.visibilities
    if visibilities is not None:
        shares = (forest.root_weights * visibilities)[groups.rows]
        means = np.minimum(np.add.reduceat(shares, groups.start[:-1]) / weights, np.float32(1))
        visibilities = np.where(groups.sizes > 1, means, visibilities[groups.representatives])
    return NewLevel(
        size=radius,
        rows=groups.rows,
        start=groups.start[:-1],
        representatives=groups.representatives,
        merged=merged,
        weights=weights,
        visibilities=visibilities,
        extents=extents_of(merged, radius, resolved.growth) if radius > 0 else None,  # all at one place: a ball
    )


def extents_of(nodes: Gaussians, radius: float, growth: float) -> Float32[Array, "n"]:
    """The extents of the nodes of a level, given its radius, world units, and the factor to that of the next level."""
    x, y, z = nodes.log_scales.T
    log_sizes = np.maximum(np.maximum(x, y), z).astype(np.float64)
    most = (1 - 1e-6) * math.log(growth) / 2  # no node of a level reaches into the next one, whatever is rounded
    wanted = SPREAD * (log_sizes - math.log(radius / USUAL))
    extents = DRAWN * radius * np.exp(wanted / np.sqrt(1 + (wanted / most) ** 2))
    limits = np.finfo(np.float32)
    held: Array = np.clip(extents, limits.tiny, limits.max).astype(np.float32)
    return held


class Rules(TypedDict):
    """Who joins whom at a level."""

    radius: float
    """r, world units."""
    color_radius: float
    """Distance in linear RGB that counts as much as the radius; infinity leaves colour out."""
    limit: MergeLimit | None
    """What a merge may change; None: distance alone decides."""


def question_of(forest: Forest, resolved: ResolvedBuild, radius: float) -> tuple[tuple[Array, Array, Array], Rules]:
    """What the roots of a forest are thinned by at a level: means, colours and importance, and the rules."""
    present = forest.present
    color_radius, limit = np.inf if resolved.color_radius is None else resolved.color_radius, None
    if forest.visibilities is not None and radius > 0:
        steps = radius / resolved.first_size
        color_radius *= steps**COLOR_POWER
        if radius <= resolved.last_size:
            most = min(CHANGE * radius * radius * steps**CHANGE_POWER, float(np.finfo(np.float32).max))
            limit = MergeLimit(present, forest.root_weights, forest.visibilities, most)
    rules = Rules(radius=radius, color_radius=color_radius, limit=limit)
    return (present.means, linear_colors(present), importance_of(present, resolved.importance)), rules
