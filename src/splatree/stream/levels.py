"""Levels of a stream: cuts of the tree that differ in size alone, so that any mix of them over chunks is a cut.

The cut at a size e draws, on each path from the chunk's topmost nodes to a leaf, the first node whose extent is at most e, and
the leaf if there is none. A node is therefore drawn at the sizes from its own extent (0 of a leaf) up to the least extent above
it in the chunk. The nodes at e are those whose interval holds e, and the sorted ends of all intervals give the number of nodes
at every e.

The spine above the chunks is in no level. So the nodes of one chunk never stand for leaves of another: whatever level a viewer
takes for each chunk, every leaf is drawn once, by itself or by one node above it.

A viewer's bands of distance triple, so levels that differ little spend a budget far away: levels of 1/2.5 of the nodes are nearer
to all Gaussians from close by than halves, by up to 3 dB, and fewer bytes (docs/how-to/publish-a-stream.md). A tree by pairs has
some thirty different extents, and so as many cuts. They could be divided further, by the smaller nodes of one extent first, which
gains nothing. So the ladder takes the cuts that the tree has.

Cost: a pass over the tree and two sorts, about a second for 7 M nodes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.maths.forests import parents_by_level
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int32, Int64, check_fields
from splatree.stream.chunks import TreeChunks

__all__ = [
    "COARSEST_SHARE",
    "RATIO",
    "Intervals",
    "Level",
    "check_ladder",
    "cuts_of",
    "intervals_from",
    "intervals_of",
    "levels_of_tree",
]

RATIO = 2.5
"""Nodes of a level for each node of the next coarser one."""

COARSEST_SHARE = 1 / 64
"""Nodes of the coarsest level for each leaf: viewers show it first, and all of it. A coarser one is a blur that stays on the
screen for seconds."""

_NODES_PER_CHUNK_MIN = 12
"""A level with fewer nodes a chunk has little left to say of each."""

_SMALLER_MIN = 0.8
"""A level has at most this share of the nodes of the level before it."""

_ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True, eq=False)
class Intervals:
    """At which sizes each row is drawn: ``from_size <= e < to_size``."""

    from_size: Float32[Array, "n"]
    """The row's extent, 0 of a leaf, infinity of the spine."""
    to_size: Float32[Array, "n"]
    """The least extent above the row in its chunk, infinity at the chunk's top."""

    def __post_init__(self) -> None:
        check_fields(self)

    def rows_at(self, size: float) -> Int32[Array, "v"]:
        """Rows of the cut, ascending."""
        e, parts = np.float32(size), [np.zeros(0, np.int32)]
        for run in _runs(len(self.from_size)):
            rows = np.flatnonzero((self.from_size[run] <= e) & (e < self.to_size[run])).astype(np.int32)
            parts.append(rows + np.int32(run.start))
        return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Level:
    """One level of all chunks."""

    size: float
    """e: the extent up to which nodes stand for what is below them, world units; 0 for the leaves."""
    rows: Int32[Array, "v"]
    """Rows of the level, ascending: chunk by chunk."""
    offsets: Int64[Array, "c+1"]
    """Chunk i has the rows ``rows[offsets[i] : offsets[i + 1]]``."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.rows)

    def of_chunk(self, chunk: int) -> Int32[Array, "v"]:
        """Rows of one chunk."""
        return self.rows[self.offsets[chunk] : self.offsets[chunk + 1]]


def intervals_of(tree: GaussianTree, chunks: TreeChunks) -> Intervals:
    """The sizes at which each row of the tree is drawn."""
    from_size = np.where(tree.is_leaf, np.float32(0), tree.extents)
    from_size[chunks.is_spine] = np.inf
    return intervals_from(from_size, tree.depth)


def intervals_from(from_size: Float32[Array, "n"], depth: Array) -> Intervals:
    """The intervals of rows in preorder that are drawn from these sizes on; ``depth`` counts from the topmost of them."""
    to_size = np.full(len(from_size), np.inf, np.float32)
    for rows, parents in parents_by_level(depth):
        to_size[rows] = np.minimum(to_size[parents], from_size[parents])
    return Intervals(from_size, to_size)


def levels_of_tree(
    tree: GaussianTree, chunks: TreeChunks, *, ratio: float = RATIO, num_levels: int | None = None
) -> tuple[Level, ...]:
    """The leaves, and coarser levels that each have about ``1 / ratio`` of the nodes of the level before.

    Without ``num_levels`` the coarsest has about 1/64 of the nodes of the finest. There may be fewer levels than asked for: a
    tree whose extents have few different values has few different cuts.

    Raises:
        InputError: ``ratio`` is not above 1.2, or ``num_levels`` is not above 0.
    """
    check_ladder(ratio, num_levels)
    intervals = intervals_of(tree, chunks)
    sizes, counts = cuts_of(intervals)
    levels = [_level(intervals, chunks, 0.0)]
    for target in _targets(len(levels[0]), len(chunks), ratio, num_levels) if len(sizes) else ():
        nearest = _nearest(counts, target)
        if len(levels) == num_levels:
            break
        if counts[nearest] <= _SMALLER_MIN * len(levels[-1]):
            levels.append(_level(intervals, chunks, float(sizes[nearest])))
    return tuple(levels)


def check_ladder(ratio: float, num_levels: int | None) -> None:
    """Refuse levels that cannot be made.

    Raises:
        InputError: ``ratio`` is not above 1.2, or ``num_levels`` is not above 0.
    """
    if not 1.2 <= ratio < math.inf:
        raise InputError(f"ratio: found {ratio}, wanted at least 1.2")
    if num_levels is not None and num_levels < 1:
        raise InputError(f"levels: found {num_levels}, wanted at least 1")


def _targets(num_leaves: int, num_chunks: int, ratio: float, num_levels: int | None) -> list[float]:
    """Nodes that the levels above the finest should have: down to the coarsest share, or to one node if levels are counted."""
    fewest = 1.0 if num_levels is not None else max(COARSEST_SHARE * num_leaves, _NODES_PER_CHUNK_MIN * num_chunks)
    targets = [num_leaves / ratio]
    while targets[-1] > fewest:
        targets.append(max(targets[-1] / ratio, fewest))
    return targets if targets[-1] >= fewest else []


def cuts_of(intervals: Intervals) -> tuple[Float32[Array, "d"], Int32[Array, "d"]]:
    """Every size at which the cut changes, above 0, and the number of nodes from there on, which never grows.

    A size at which nodes end is one at which the node above them begins. Memory: 16 bytes for each merged node.
    """
    num_used, begins = 0, [np.zeros(0, np.float32)]
    for run in _runs(len(intervals.from_size)):
        used = intervals.from_size[run][intervals.from_size[run] < intervals.to_size[run]]
        num_used += len(used)
        begins.append(used[used > 0])
    sizes = np.concatenate(begins)
    del begins
    num_nodes = num_used - len(sizes)  # of the finest cut
    sizes.sort()
    is_first = np.append(True, sizes[1:] != sizes[:-1])[: len(sizes)]
    first = np.flatnonzero(is_first).astype(np.int32)
    counts = np.diff(first, append=np.int32(len(sizes)))
    sizes = sizes[is_first]
    del first, is_first
    for run in _runs(len(intervals.from_size)):
        ends = intervals.to_size[run][intervals.from_size[run] < intervals.to_size[run]]
        np.subtract.at(counts, np.searchsorted(sizes, ends[ends < np.inf]), 1)
    np.cumsum(counts, out=counts)
    counts += np.int32(num_nodes)
    return sizes, counts


def _nearest(counts: Array, target: float) -> int:
    """Where the ratio of a number of nodes to the wanted one is nearest to 1, the first such place; numbers never grow."""
    below = min(len(counts) - int(np.searchsorted(counts[::-1], target, side="right")), len(counts) - 1)
    value = min(counts[max(below - 1, 0)], counts[below], key=lambda count: abs(float(np.log(count / target))))
    return len(counts) - int(np.searchsorted(counts[::-1], value, side="right"))


def _runs(num_rows: int) -> Iterator[slice]:
    """Rows in runs, so that what is made of them beside takes little."""
    return (slice(first, min(first + _ROWS_AT_ONCE, num_rows)) for first in range(0, num_rows, _ROWS_AT_ONCE))


def _level(intervals: Intervals, chunks: TreeChunks, size: float) -> Level:
    rows = intervals.rows_at(size)
    return Level(size, rows, np.append(np.searchsorted(rows, chunks.start), len(rows)))
