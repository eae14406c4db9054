"""Chunks of a tree: runs of rows, each made of whole sibling subtrees.

Rows are in depth-first preorder, so siblings with their subtrees are a run of rows. From the roots down, a node with more leaves
than a chunk may have belongs to the *spine*: its children are divided instead. Siblings with fewer leaves are grouped, neighbours
first, while their leaves fit. So every leaf lies in one chunk, and the nodes above the chunks are the spine.

A viewer chooses the level of a chunk by the distance to its box. Therefore a group also ends where its box would become
much longer than its longest member and than a chunk of this scene usually is: far outliers get chunks of their own.
"""

from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.io.memory import Scratch
from splatree.render.paths import bounds_of
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Bool, Int32, check_fields

__all__ = ["TreeChunks", "chunks_of_tree", "divide", "leaves_of_chunk"]

_NUM_CHUNKS = 128
"""Chunks that a small scene has. With twelve or twenty, a near view has too few to choose from: a quarter of the leaves a chunk
brings it 1 to 12 dB nearer at equal bytes (two scenes of 150,000 and 250,000 Gaussians)."""

_FEWEST_LEAVES, _MOST_LEAVES = 2_048, 16_384
"""Leaves of a chunk. Chunks of four times as many as the most cost 2 dB at equal numbers of nodes in a view."""

_LONGER_MAX = 4.0
"""A group's box may be so many times as long as its longest member's."""


@dataclass(frozen=True, eq=False)
class TreeChunks:
    """Runs of rows that hold every leaf once, in the order of the tree."""

    start: Int32[Array, "c"]
    """First row of each chunk."""
    end: Int32[Array, "c"]
    """One past the last row of each chunk."""
    is_spine: Bool[Array, "n"]
    """Whether a row lies above the chunks; then it is in none."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.start)


def chunks_of_tree(scene: Scene, chunk_leaves: int | None = None, scratch: Scratch | None = None) -> TreeChunks:
    """Divide the tree of a scene into chunks of at most ``chunk_leaves`` leaves; None: `leaves_of_chunk`.

    What grows with the scene lies in ``scratch``.

    Raises:
        InputError: the scene is empty, or ``chunk_leaves`` is not above 0.
    """
    if chunk_leaves is None:
        chunk_leaves = leaves_of_chunk(scene.tree.num_leaves)
    if chunk_leaves < 1:
        raise InputError(f"chunk_leaves: found {chunk_leaves}, wanted at least 1")
    if len(scene) == 0:
        raise InputError("stream: found an empty scene, wanted at least one Gaussian")
    n, scratch = len(scene), scratch or Scratch.endless()
    _, radius = bounds_of(scene)
    usual = 2 * radius * np.sqrt(chunk_leaves / scene.tree.num_leaves)  # leaves lie on surfaces
    runs, spine = divide(scene, count_leaves_before(scene.tree, scratch.part(0.5)), (0, n), chunk_leaves, usual)
    is_spine = scratch.zeros((n,), bool)
    is_spine[spine] = True
    start, end = np.array(runs, np.int32).T.copy()
    return TreeChunks(start, end, is_spine)


def count_leaves_before(tree: GaussianTree, scratch: Scratch) -> Int32[Array, "n+1"]:
    """The leaves before each row, and all, in an array of ``scratch``."""
    counts = scratch.zeros((len(tree) + 1,), np.int32)
    np.cumsum(tree.is_leaf, dtype=np.int32, out=counts[1:])
    return counts


def leaves_of_chunk(num_leaves: int) -> int:
    """Leaves of a chunk that suit a scene: for about 128 chunks, within 2,048 and 16,384."""
    return min(max(num_leaves // _NUM_CHUNKS, _FEWEST_LEAVES), _MOST_LEAVES)


def divide(
    scene: Scene, leaves_before: Array, span: tuple[int, int], most_leaves: int, usual: float = np.inf
) -> tuple[list[tuple[int, int]], list[int]]:
    """Divide rows ``span``, whole sibling subtrees, into such runs of at most ``most_leaves`` leaves, and the rows above these.

    ``leaves_before`` counts the leaves before each row "n+1". A group is at most four times as long as its longest member or as
    ``usual``, world units.
    """
    end, means = scene.tree.subtree_end, scene.gaussians.means
    runs: list[tuple[int, int]] = []
    spine: list[int] = []
    pending = [span]
    while pending:
        first, last = pending.pop()
        group = _Group(first)
        while group.end < last:
            row = group.end
            after = int(end[row])
            num_leaves = int(leaves_before[after] - leaves_before[row])
            if num_leaves > most_leaves and after > row + 1:
                spine.append(row)
                pending += [(after, last), (row + 1, after)]  # the second is done first
                break
            low, high = means[row:after].min(axis=0), means[row:after].max(axis=0)
            if not group.takes(num_leaves, low, high, most_leaves, usual):
                runs.append((group.start, row))
                group = _Group(row)
            group.add(after, num_leaves, low, high)
        if group.end > group.start:
            runs.append((group.start, group.end))
    return runs, spine


class _Group:
    """Siblings that become a chunk."""

    def __init__(self, start: int) -> None:
        self.start = self.end = start
        self.num_leaves = 0
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        self.longest = 0.0

    def takes(self, num_leaves: int, low: Array, high: Array, most_leaves: int, usual: float) -> bool:
        """Whether one more member fits."""
        if self.end == self.start:
            return True
        side = float((np.maximum(self.high, high) - np.minimum(self.low, low)).max())
        longest = max(self.longest, float((high - low).max()), usual)
        return self.num_leaves + num_leaves <= most_leaves and side <= _LONGER_MAX * longest

    def add(self, end: int, num_leaves: int, low: Array, high: Array) -> None:
        """Take a member in."""
        self.end = end
        self.num_leaves += num_leaves
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
        self.longest = max(self.longest, float((high - low).max()))
