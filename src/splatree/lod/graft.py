"""One scene from parts and from what has grown above their roots.

The rows of a part stay as they are: each subtree is a range of rows in preorder, and moves as a whole to its place below the
nodes above it. Only these nodes are new. Cost: one copy of all rows.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from splatree.errors import InputError
from splatree.io.joined import joined_source
from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.lod.assemble import order_of, record_of, roots_of, with_report, with_tree
from splatree.lod.forest import Forest
from splatree.lod.order import Order
from splatree.lod.resolve import ResolvedBuild
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import common_record
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Int64

__all__ = ["graft"]


def graft(top: Forest, parts: Sequence[Scene], resolved: ResolvedBuild, *, threads: int = 0) -> Scene:
    """The scene whose roots are those of ``top`` and whose subtrees are those of the parts.

    Args:
        top: what `grow` made of `forest_of_roots` of the same parts.
        parts: scenes that `assemble` made; their order does not matter to the tree.
        resolved: what was decided for the whole scene.
        threads: threads to use; 0: all.

    Returns:
        One scene. Its leaves keep their identities if no two parts share one; inner nodes have new ones.

    Raises:
        InputError: the parts are drawn in different ways, are too many rows together, or are not those of ``top``.
    """
    _check(top, parts)
    small = order_of(top)
    seats = _seats(top, small, parts)
    degree = max(part.gaussians.sh_degree for part in parts)
    names = [f.name for f in dataclasses.fields(Gaussians)]
    part_columns = [part.gaussians.with_sh_degree(degree) for part in parts]
    above = _above(top, small, [g.sh[seat.roots] for g, seat in zip(part_columns, seats.parts, strict=True)], threads)

    def grafted(name: str) -> Array:
        inner: Array = getattr(above, name)
        column = np.empty((seats.num_rows, *inner.shape[1:]), inner.dtype)
        for g, seat in zip(part_columns, seats.parts, strict=True):
            column[seat.rows] = getattr(g, name)
        column[seats.above] = inner
        return column

    gaussians = Gaussians(**{name: grafted(name) for name in names})
    tree = _tree(top, small, parts, seats)
    record = common_record([part.tree.record for part in parts if part.tree.record] + [record_of(resolved, top.sizes)])
    tree = dataclasses.replace(tree, record=record, roots=roots_of(top, small, resolved))
    sizes = list(record.steps) if record else []
    source = with_report(
        joined_source([part.source for part in parts]),
        resolved,
        sizes,
        {"parts": len(parts), "nodes_above_parts": list(top.counts)},
    )
    return with_tree(parts[0], gaussians, tree, _ids(parts, seats, tree), source, threads=threads)


@dataclasses.dataclass(frozen=True, eq=False)
class _Seat:
    """Where the rows of one part go."""

    roots: Int64[Array, "r"]
    """Rows of its roots in the part."""
    rows: Int64[Array, "n"]
    """Row of the whole of each of its rows."""
    depth: Int64[Array, "n"]
    """Depth of the root above each of its rows, in the whole."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Seats:
    """Where all rows go."""

    num_rows: int
    parts: list[_Seat]
    above: Int64[Array, "i"]
    """Row of the whole of each node above the parts, by its number."""
    first_row: Int64[Array, "s+1"]
    """Row of the whole at which each row of the small tree begins, in which parts' roots are leaves; and one past the last."""


def _seats(top: Forest, small: Order, parts: Sequence[Scene]) -> _Seats:
    num_base = len(top.base.order)
    roots = [np.flatnonzero(part.tree.depth == 0) for part in parts]
    sizes = np.concatenate([part.tree.subtree_end[r] - r for part, r in zip(parts, roots, strict=True)])
    small_row = np.empty(num_base, np.int64)  # of each root, in the order of the parts
    small_row[top.base.order] = small.row_from_node[:num_base]
    num_rows_of = np.ones(len(small.row_from_node), np.int64)
    num_rows_of[small_row] = sizes
    first_row = np.concatenate([[0], np.cumsum(num_rows_of)])
    depth = small.tree.depth[small_row].astype(np.int64)
    seats, first = [], 0
    for part, part_roots in zip(parts, roots, strict=True):
        of_part = slice(first, first + len(part_roots))
        first = of_part.stop
        rows = np.repeat(first_row[small_row[of_part]] - part_roots, sizes[of_part]) + np.arange(len(part))
        seats.append(_Seat(part_roots, rows, np.repeat(depth[of_part], sizes[of_part])))
    return _Seats(int(first_row[-1]), seats, first_row[small.row_from_node[num_base:]], first_row)


def _above(top: Forest, small: Order, root_sh: list[Array], threads: int) -> Gaussians:
    """The nodes above the parts, by number; their harmonics are means of those of their children."""
    n, num_base = len(top), len(top.base.order)
    row = small.row_from_node
    inner = Gaussians.concatenate(list(top.columns[1:])) if len(top.columns) > 1 else Gaussians.empty()
    sh_of_base = np.concatenate(root_sh)[top.base.order]
    sh = np.zeros((n, *sh_of_base.shape[1:]), np.float32)
    sh[row[:num_base]] = sh_of_base
    weights = np.empty(n, np.float32)
    weights[row] = np.concatenate(top.weights)
    merge_kernel.average_children(sh, small.tree.subtree_end, weights, threads=threads)
    return dataclasses.replace(inner, sh=sh[row[num_base:]])


def _tree(top: Forest, small: Order, parts: Sequence[Scene], seats: _Seats) -> GaussianTree:
    n = seats.num_rows
    subtree_end, depth = np.empty(n, np.int32), np.empty(n, np.int64)
    extents = np.empty(n, np.float32)
    for part, seat in zip(parts, seats.parts, strict=True):
        subtree_end[seat.rows] = part.tree.subtree_end + (seat.rows - np.arange(len(part)))
        depth[seat.rows] = part.tree.depth + seat.depth
        extents[seat.rows] = part.tree.extents
    rows = small.row_from_node[len(top.base.order) :]
    subtree_end[seats.above] = seats.first_row[small.tree.subtree_end[rows]]
    depth[seats.above] = small.tree.depth[rows]
    extents[seats.above] = small.tree.extents[rows]
    if n and depth.max() > 255:
        raise InputError(f"graft: found a node {depth.max()} levels below its root, wanted at most 255; raise growth")
    return GaussianTree(subtree_end, depth.astype(np.uint8), extents)


def _ids(parts: Sequence[Scene], seats: _Seats, tree: GaussianTree) -> Array:
    """Identities of leaves as the parts have them, if they are all different; inner nodes follow after the largest."""
    ids, is_leaf = np.zeros(seats.num_rows, np.uint32), tree.is_leaf
    for part, seat in zip(parts, seats.parts, strict=True):
        ids[seat.rows] = np.arange(len(part), dtype=np.uint32) if part.ids is None else part.ids
    leaf_ids = ids[is_leaf]
    first_id, num_inner = int(leaf_ids.max(initial=0)) + 1, int((~is_leaf).sum())
    if len(np.unique(leaf_ids)) < len(leaf_ids) or first_id + num_inner > 2**32:
        ids[is_leaf], first_id = np.arange(len(leaf_ids), dtype=np.uint32), len(leaf_ids)
    ids[~is_leaf] = np.arange(first_id, first_id + num_inner, dtype=np.uint32)
    return ids


def _check(top: Forest, parts: Sequence[Scene]) -> None:
    num_roots = sum(int(np.count_nonzero(part.tree.depth == 0)) for part in parts)
    if num_roots != len(top.base.order):
        raise InputError(
            f"graft: found parts with {num_roots} roots, wanted the {len(top.base.order)} that growth began with"
        )
    if (num_rows := sum(map(len, parts)) + len(top)) >= 2**31:
        raise InputError(f"graft: found {num_rows} rows together, wanted less than 2^31 in one scene")
    for number, part in enumerate(parts):
        for name in ("mode", "threshold", "tile_rule"):
            if getattr(part, name) != getattr(parts[0], name):
                raise InputError(
                    f"part {number}: found {name} {getattr(part, name)}, wanted {getattr(parts[0], name)} as in part 0"
                )
