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
from splatree.io.memory import Scratch
from splatree.maths.forests import parents_by_level
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Bool, Float32, Int32, Int64, check_fields
from splatree.stream.chunks import TreeChunks

__all__ = [
    "COARSEST_SHARE",
    "RATIO",
    "Intervals",
    "Level",
    "check_ladder",
    "cuts_of",
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
    """At which sizes each row of whole sibling subtrees is drawn: ``from_size <= e < to_size``."""

    tree: GaussianTree
    """The tree that the rows are of."""
    begin: int
    """First of the rows."""
    is_spine: Bool[Array, "t"] | None
    """Whether a row of the tree is never drawn; None: all may be."""
    to_size: Float32[Array, "n"]
    """The least extent above the row in its chunk, infinity at the chunk's top."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.to_size)

    def from_sizes(self, rows: slice | Array) -> Float32[Array, "m"]:
        """The extents of rows of the tree, 0 of leaves, infinity of the spine."""
        numbers = np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows
        sizes = np.where(self.tree.subtree_end[rows] == numbers + 1, np.float32(0), self.tree.extents[rows])
        if self.is_spine is not None:
            sizes[self.is_spine[rows]] = np.inf
        return sizes

    def runs(self) -> Iterator[tuple[slice, Float32[Array, "m"], Float32[Array, "m"]]]:
        """Rows of the tree in runs, so that what is made of them beside takes little, with both ends of their intervals."""
        for first in range(0, len(self), _ROWS_AT_ONCE):
            to_size = self.to_size[first : first + _ROWS_AT_ONCE]
            rows = slice(self.begin + first, self.begin + first + len(to_size))
            yield rows, self.from_sizes(rows), to_size

    def count_at(self, size: float) -> int:
        """Number of rows of the cut."""
        e = np.float32(size)
        return sum(int(((begins <= e) & (e < ends)).sum()) for _, begins, ends in self.runs())

    def rows_at(self, size: float, scratch: Scratch | None = None) -> Int32[Array, "v"]:
        """Rows of the cut, ascending, in an array of ``scratch``."""
        e, num_found = np.float32(size), 0
        found = (scratch or Scratch.endless()).zeros((self.count_at(size),), np.int32)
        for run, begins, ends in self.runs():
            rows = np.flatnonzero((begins <= e) & (e < ends))
            found[num_found : num_found + len(rows)] = rows + run.start
            num_found += len(rows)
        return found


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


def intervals_of(
    tree: GaussianTree,
    chunks: TreeChunks | None = None,
    span: tuple[int, int] | None = None,
    scratch: Scratch | None = None,
) -> Intervals:
    """The sizes at which rows of the tree are drawn: all, or those of ``span``, whole sibling subtrees."""
    begin, end = (0, len(tree)) if span is None else span
    is_spine = None if chunks is None else chunks.is_spine
    intervals = Intervals(tree, begin, is_spine, (scratch or Scratch.endless()).zeros((end - begin,), np.float32))
    to_size = intervals.to_size
    to_size[:] = np.inf
    depth = tree.depth if span is None else tree.depth[begin:end] - tree.depth[begin]
    for rows, parents in parents_by_level(depth):
        to_size[rows] = np.minimum(to_size[parents], intervals.from_sizes(parents + np.int32(begin)))
    return intervals


def levels_of_tree(
    tree: GaussianTree,
    chunks: TreeChunks,
    *,
    ratio: float = RATIO,
    num_levels: int | None = None,
    scratch: Scratch | None = None,
) -> tuple[Level, ...]:
    """The leaves, and coarser levels that each have about ``1 / ratio`` of the nodes of the level before.

    Without ``num_levels`` the coarsest has about 1/64 of the nodes of the finest. There may be fewer levels than asked for: a
    tree whose extents have few different values has few different cuts.

    Raises:
        InputError: ``ratio`` is not above 1.2, or ``num_levels`` is not above 0.
    """
    check_ladder(ratio, num_levels)
    scratch = scratch or Scratch.endless()
    soon_gone = scratch.part(0.5)
    intervals = intervals_of(tree, chunks, scratch=soon_gone)
    chosen = _sizes_of_levels(intervals, len(chunks), ratio, num_levels, soon_gone)
    return tuple(_level(intervals, chunks, size, scratch) for size in chosen)


def _sizes_of_levels(
    intervals: Intervals, num_chunks: int, ratio: float, num_levels: int | None, scratch: Scratch
) -> list[float]:
    """The sizes of the levels, 0 first."""
    sizes, counts = cuts_of(intervals, scratch)
    chosen, num_nodes = [0.0], intervals.count_at(0.0)
    for target in _targets(num_nodes, num_chunks, ratio, num_levels) if len(sizes) else ():
        nearest = _nearest(counts, target)
        if len(chosen) == num_levels:
            break
        if counts[nearest] <= _SMALLER_MIN * num_nodes:
            chosen.append(float(sizes[nearest]))
            num_nodes = int(counts[nearest])
    return chosen


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


def cuts_of(intervals: Intervals, scratch: Scratch | None = None) -> tuple[Float32[Array, "d"], Int32[Array, "d"]]:
    """Every size at which the cut changes, above 0, and the number of nodes from there on, which never grows.

    A size at which nodes end is one at which the node above them begins. Memory: 8 bytes for each merged node, of ``scratch``.
    """
    scratch, num_merged, num_finest = scratch or Scratch.endless(), 0, 0
    for _, begins, ends in intervals.runs():
        num_merged += int(((begins > 0) & (begins < ends)).sum())
        num_finest += int(((begins <= 0) & (begins < ends)).sum())
    sizes, num_filled = scratch.zeros((num_merged,), np.float32), 0
    for _, begins, ends in intervals.runs():
        used = begins[(begins > 0) & (begins < ends)]
        sizes[num_filled : num_filled + len(used)] = used
        num_filled += len(used)
    sizes.sort()
    counts = scratch.zeros((num_merged,), np.int32)
    num_sizes = _merge_equals(sizes, counts)
    sizes, counts = sizes[:num_sizes], counts[:num_sizes]
    for _, begins, ends in intervals.runs():
        ends = ends[begins < ends]
        np.subtract.at(counts, np.searchsorted(sizes, ends[ends < np.inf]), 1)
    np.cumsum(counts, out=counts)
    counts += np.int32(num_finest)
    return sizes, counts


def _merge_equals(values: Array, counts: Array) -> int:
    """Move the different ones of ascending values to the front, count each in ``counts``, and return how many there are."""
    num_different = 0
    for first in range(0, len(values), _ROWS_AT_ONCE):
        different, how_often = np.unique(values[first : first + _ROWS_AT_ONCE], return_counts=True)
        if num_different and different[0] == values[num_different - 1]:
            num_different -= 1
            how_often[0] += counts[num_different]
        values[num_different : num_different + len(different)] = different
        counts[num_different : num_different + len(different)] = how_often
        num_different += len(different)
    return num_different


def _nearest(counts: Array, target: float) -> int:
    """Where the ratio of a number of nodes to the wanted one is nearest to 1, the first such place; numbers never grow."""
    below = min(len(counts) - int(np.searchsorted(counts[::-1], target, side="right")), len(counts) - 1)
    value = min(counts[max(below - 1, 0)], counts[below], key=lambda count: abs(float(np.log(count / target))))
    return len(counts) - int(np.searchsorted(counts[::-1], value, side="right"))


def _level(intervals: Intervals, chunks: TreeChunks, size: float, scratch: Scratch) -> Level:
    rows = intervals.rows_at(size, scratch)
    return Level(size, rows, np.append(np.searchsorted(rows, chunks.start), len(rows)))
