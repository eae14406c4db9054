"""Nodes and families while levels grow, before they are put into the order of rows (`lod/order.py`).

Growth begins with *base nodes*: the leaves of a scene, or the roots of parts that were built before. Nodes are numbered base
first, then level by level. Base nodes stand in the order of their rank: Morton code, then row of the input. All that growth does
depends on this order and not on absolute numbers, so a part of a scene grows as it would within the whole.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.lod.order import Families
from splatree.lod.resolve import ResolvedBuild
from splatree.maths.morton import morton_codes
from splatree.scene.gaussians import Gaussians
from splatree.scene.roots import Roots
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, Float64, Int32, Int64, UInt64, check_fields
from splatree.simplify.merge import weights_of
from splatree.simplify.visibility import visibilities_in

__all__ = ["Base", "Forest", "NewLevel", "forest_above", "forest_of_leaves", "forest_of_roots"]


@dataclass(frozen=True, eq=False)
class Base:
    """The nodes that growth begins with, in the order of their rank."""

    order: Int32[Array, "n"]
    """Place of each in the input: its row, or its number among the roots of all parts."""
    codes: UInt64[Array, "n"]
    """Morton code of each, or of the leaf that its chain of representatives began with."""
    inputs: Int64[Array, "n"]
    """Row of that leaf in the input of the whole build."""
    reaches: Float64[Array, "n"] | None
    """Radius of the ball that holds each one's subtree, world units; None: leaves, whose 3σ it is."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Forest:
    """What has grown so far."""

    base: Base
    """Where growth began."""
    columns: tuple[Gaussians, ...]
    """Base nodes, then each level's new nodes, harmonics to degree 0."""
    weights: tuple[Float32[Array, "_"], ...]
    """Weights of the same nodes: sums over their leaves."""
    families: tuple[Families, ...]
    """The families of each level that has any, the finest first."""
    sizes: tuple[float, ...]
    """Radius or pixel size of these levels, world units."""
    counts: tuple[int, ...]
    """Nodes without a parent: at the beginning, and after each of these levels."""
    num_sizes: int
    """Sizes of levels that were gone through, with families or without."""
    roots: Int32[Array, "r"]
    """Nodes without a parent, in the order of their rank."""
    chains: Int32[Array, "r"]
    """The base node that each root's chain of representatives began with; ascending."""
    present: Gaussians
    """Columns of the roots, harmonics to degree 0."""
    root_weights: Float32[Array, "r"]
    """Weights of the roots."""
    visibilities: Float32[Array, "r"] | None
    """How much of each root is seen; None: the rule does not ask."""
    grown: Int32[Array, "r"] | None = None
    """How many sizes each root has gone through; None: all that the forest has."""

    def __len__(self) -> int:
        """Nodes of all levels."""
        return sum(map(len, self.weights))

    def skipped(self) -> "Forest":
        """The forest after a level at which nothing was merged."""
        return dataclasses.replace(self, num_sizes=self.num_sizes + 1)

    def with_level(self, level: "NewLevel") -> "Forest":
        """The forest with one level more: groups of two or more roots become families, a root alone stays as it is."""
        sizes = np.diff(level.start, append=len(level.rows))
        is_family = sizes > 1
        if not is_family.any():
            return dataclasses.replace(self.skipped(), grown=level.grown)
        first, num_families = len(self), int(is_family.sum())
        children = self.roots[level.rows[np.repeat(is_family, sizes)]]
        start = np.cumsum(sizes[is_family]) - sizes[is_family]
        roots = self.roots[level.representatives]
        roots[is_family] = np.arange(first, first + num_families, dtype=np.int32)
        extents = None if level.extents is None else level.extents[is_family]
        return dataclasses.replace(
            self,
            columns=(*self.columns, level.merged.take(is_family)),
            weights=(*self.weights, level.weights[is_family]),
            families=(*self.families, Families(first, children, start, extents)),
            sizes=(*self.sizes, level.size),
            counts=(*self.counts, len(roots)),
            num_sizes=self.num_sizes + 1,
            roots=roots,
            chains=self.chains[level.representatives],
            present=level.merged,
            root_weights=level.weights,
            visibilities=level.visibilities,
            grown=level.grown,
        )


@dataclass(frozen=True, eq=False)
class NewLevel:
    """What one level makes of the roots of a forest: a partition of them into groups, and the merged Gaussian of each."""

    size: float
    """Radius or pixel size of the level, world units."""
    rows: Int32[Array, "r"]
    """Roots by group, by their place among the roots; ascending inside each group."""
    start: Int64[Array, "g"]
    """Where in ``rows`` each group starts."""
    representatives: Int32[Array, "g"]
    """The root that gives each group its rank; ascending."""
    merged: Gaussians
    """One Gaussian for each group; that of a group of one is the root itself."""
    weights: Float32[Array, "g"]
    """Weight of each group."""
    visibilities: Float32[Array, "g"] | None = None
    """How much of each group is seen; None: the rule does not ask."""
    extents: Float32[Array, "g"] | None = None
    """Extent of each group if it becomes a node, world units; None: that of a ball that holds what is below."""
    grown: Int32[Array, "g"] | None = None
    """How many sizes each group has gone through; None: all."""


def forest_of_leaves(
    scene: Scene,
    resolved: ResolvedBuild,
    *,
    inputs: Int64[Array, "n"] | None = None,
    visibilities: Float32[Array, "n"] | None = None,
    threads: int = 0,
) -> Forest:
    """The forest that growth begins with: each Gaussian of a flat scene is a root.

    Args:
        scene: a flat scene, or a part of one.
        resolved: what was decided for the whole scene.
        inputs: row of each Gaussian in the whole scene; None: the scene is whole.
        visibilities: how much of each Gaussian is seen in the whole scene; None: measured in this scene, if the rule asks.
        threads: threads to use; 0: all.

    Returns:
        A forest without families, in the order of rank.
    """
    leaves = scene.gaussians
    codes = morton_codes(leaves.means, resolved.frame)
    if inputs is None:
        inputs, order = np.arange(len(leaves), dtype=np.int64), np.argsort(codes, kind="stable").astype(np.int32)
    else:
        order = np.lexsort((inputs, codes)).astype(np.int32)
    weights = weights_of(leaves, resolved.merge.weight or "opacity", log_unit=resolved.log_unit)[order]
    if visibilities is None and resolved.visibility:
        visibilities = visibilities_in(scene.mode, leaves, threads=threads)
    if visibilities is not None:
        visibilities = visibilities[order]
    if resolved.method == "pairs":
        visibilities = np.ones(len(leaves), np.float32) if visibilities is None else visibilities
        weights *= visibilities
    base = Base(order, codes[order], inputs[order], None)
    return _planted(base, leaves.with_sh_degree(0).take(order), weights, visibilities, 0)


def forest_of_roots(parts: Sequence[Scene], resolved: ResolvedBuild) -> Forest:
    """The forest that goes on above parts: the roots of all of them, in the order of their rank.

    By a radius, parts whose record does not say that visibilities were measured, such as those of files of before, have roots
    of which nothing is known. Above any of them, distance alone decides what is merged.

    Args:
        parts: scenes that `assemble` made of forests of the same resolved build, all grown to the same level.
        resolved: what was decided for the whole scene.

    Raises:
        InputError: a part does not know the state of its roots, or is of another build or another level.
    """
    if not parts:
        raise InputError("parts: found none, wanted at least one")
    states = [_state_of(part, number, resolved) for number, part in enumerate(parts)]
    waits = any(state.grown is not None for state in states)
    if not waits and len({state.num_sizes for state in states}) > 1:
        found = sorted({state.num_sizes for state in states})
        raise InputError(f"parts: found parts grown to {found} sizes of levels, wanted all grown to the same")
    roots = [part.gaussians.with_sh_degree(0).take(np.flatnonzero(part.tree.depth == 0)) for part in parts]
    forest = forest_above(Gaussians.concatenate(roots), Roots.concatenate(states), resolved)
    is_measured = all(part.tree.record is not None and part.tree.record.visibility for part in parts)
    return forest if resolved.method == "pairs" or is_measured else dataclasses.replace(forest, visibilities=None)


def forest_above(gaussians: Gaussians, state: Roots, resolved: ResolvedBuild) -> Forest:
    """The forest that goes on above nodes without a parent.

    Args:
        gaussians: the nodes, as they were merged; harmonics to degree 0.
        state: the state of growth of each.
        resolved: what was decided for the whole scene.

    Returns:
        A forest without families, in the order of rank.
    """
    order = np.lexsort((state.inputs, state.codes)).astype(np.int32)
    state = state.take(order)
    base = Base(order, state.codes, state.inputs, state.reaches)
    visibilities = state.visibilities if resolved.method == "pairs" or resolved.visibility else None
    num_sizes = state.num_sizes if state.grown is None else int(state.grown.min(initial=state.num_sizes))
    return _planted(base, gaussians.take(order), state.weights, visibilities, num_sizes, state.grown)


def _planted(
    base: Base,
    columns: Gaussians,
    weights: Array,
    visibilities: Array | None,
    num_sizes: int,
    grown: Array | None = None,
) -> Forest:
    nodes = np.arange(len(columns), dtype=np.int32)
    return Forest(
        base=base,
        columns=(columns,),
        weights=(weights,),
        families=(),
        sizes=(),
        counts=(len(nodes),),
        num_sizes=num_sizes,
        roots=nodes,
        chains=nodes,
        present=columns,
        root_weights=weights,
        visibilities=visibilities,
        grown=grown,
    )


def _state_of(part: Scene, number: int, resolved: ResolvedBuild) -> Roots:
    state, record = part.tree.roots, part.tree.record
    if state is None or record is None:
        raise InputError(
            f"part {number}: found a scene that does not know the state of its roots, wanted one that assemble made; build the "
            "part again"
        )
    if state.log_unit != resolved.log_unit or record.merge != resolved.merge or part.mode != resolved.mode:
        raise InputError(
            f"part {number}: found a part of another build, wanted all of them to share one resolved build"
        )
    return state
