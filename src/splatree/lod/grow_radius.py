"""Levels by a radius: each thins the one before with a radius that is g times as large.

A group of two or more becomes a new node with its members as children. A group of one moves up itself, so no node has a single
child. Weights are summed upwards, so means, covariances and colours of a node are those of its leaves. Harmonics above DC play no
part in the grouping; `assemble` averages them at the end.

Cost: a thinning and a merge a level, the levels together two to four times the leaves.
"""

import numpy as np

from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.build import thin as thin_kernel
from splatree.lod.forest import Forest, NewLevel
from splatree.lod.resolve import ResolvedBuild
from splatree.progress import task
from splatree.scene.thinning import Groups
from splatree.simplify.merge import importance_of
from splatree.simplify.thin import linear_colors

__all__ = ["grow_by_radius"]


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
            groups = _groups(forest, resolved, radius, threads)
            advance(float(len(forest.roots) - len(groups)))
            if len(groups) == len(forest.roots):
                forest = forest.skipped()
                continue
            level = NewLevel(
                size=radius,
                rows=groups.rows,
                start=groups.start[:-1],
                representatives=groups.representatives,
                merged=merge_kernel.merge(forest.present, groups, forest.root_weights, resolved.merge, threads=threads),
                weights=np.add.reduceat(forest.root_weights[groups.rows], groups.start[:-1]),
            )
            forest = forest.with_level(level)
    return forest


def _groups(forest: Forest, resolved: ResolvedBuild, radius: float, threads: int) -> Groups:
    present = forest.present
    return thin_kernel.thin(
        *(present.means, linear_colors(present), importance_of(present, resolved.importance)),
        radius=radius,
        color_radius=np.inf if resolved.color_radius is None else resolved.color_radius,
        threads=threads,
    )
