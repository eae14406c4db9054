"""Trees that grow while they learn: a Gaussian that is too coarse gets children, and stays as the level above them.

    μ_u = μ_v + R(q_v) (± s_a / 2, ± s_b / 2, 0),    s_u = γ s_v,    rotation, colour and opacity as those of v

for the four children u of a parent v, along its two longest axes a and b (FilterGS, §3.1, which leaves their number and γ open).
The parent is stored as it was at that moment and never learns again. With γ = ½ four children cover the area of their parent.

Training goes on with the leaves alone, and draws all of them: the paper draws the cut at 3 px of training, in which the leaves of
a far view are not drawn either, and their parents do not learn. Cost: a few vectorised passes at each birth and at the end.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from splatree.lod.assemble import with_tree
from splatree.lod.order import Families, preorder
from splatree.maths.morton import morton_codes
from splatree.maths.rotations import matrices_from_quats
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import LevelRecord
from splatree.scene.scene import Scene
from splatree.shapes import Array, Int32, check_fields

__all__ = ["CHILDREN", "SHRINKING", "Lineage", "children_of"]

CHILDREN = 4
"""Of a parent; the published program makes as many, by two divisions in turn."""

OFFSET, SHRINKING = 0.5, 0.5
"""Distance of a child from its parent along each axis, and its σ (γ), in σ of the parent."""


@dataclass(frozen=True, eq=False)
class Lineage:
    """Who came from whom. Parents stand before their children, so a number of a parent is less than one's own."""

    ancestors: Gaussians
    """Nodes that got children, as they were then, in the order in which they got them."""
    parents: Int32[Array, "a"]
    """Parent of each of them, by its place among them; −1: none."""
    of_rows: Int32[Array, "n"]
    """Parent of each row that learns; −1: none."""

    def __post_init__(self) -> None:
        check_fields(self, a=len(self.ancestors))

    @staticmethod
    def none(gaussians: Gaussians) -> "Lineage":
        """Of rows of which none has a parent."""
        return Lineage(gaussians.take(np.zeros(0, np.intp)), _nobody(0), _nobody(len(gaussians)))

    def take(self, rows: Array) -> "Lineage":
        """Of these rows; ancestors stay."""
        return Lineage(self.ancestors, self.parents, self.of_rows[rows])

    def grown(self, parents: Gaussians, rows: Array) -> "Lineage":
        """After rows got children: the first in the place of each row, the others at the end, one kind after the other."""
        first = len(self.ancestors)
        new = np.arange(first, first + len(rows), dtype=np.int32)
        of_rows = np.concatenate([self.of_rows, np.tile(new, CHILDREN - 1)])
        of_rows[rows] = new
        ancestors = Gaussians.concatenate([self.ancestors, parents])
        return Lineage(ancestors, np.concatenate([self.parents, self.of_rows[rows]]), of_rows)

    def tree(self, flat: Scene) -> Scene:
        """The rows that learned, as leaves, below their ancestors; ancestors that no leaf is left of are gone."""
        lives = self._living()
        if not lives.any():
            return flat
        number = len(flat) + np.cumsum(lives, dtype=np.int32) - 1  # of each ancestor, behind the leaves
        above = np.concatenate([self.of_rows, self.parents[lives]])
        parent = np.where(above >= 0, number[above], -1)
        height = _heights(parent)

        # Nodes by height, leaves first: a parent then has a higher number than its children.
        node = np.argsort(height, kind="stable")
        place = np.argsort(node).astype(np.int32)
        gaussians = Gaussians.concatenate([flat.gaussians, self.ancestors.take(lives)]).take(node)
        parent = np.where(parent[node] >= 0, place[parent[node]], -1)
        along = np.lexsort((morton_codes(gaussians.means), parent)).astype(np.int32)
        roots, children = along[parent[along] < 0], along[parent[along] >= 0]
        families = _families(children, parent[children], height[node])
        order = preorder(families, roots, gaussians.means, gaussians.reach())

        row = np.argsort(order.row_from_node)
        record = LevelRecord("grown", "exact", mode=flat.mode, growth=1 / SHRINKING)
        tree, ids = replace(order.tree, record=record), node[row].astype(np.uint32)
        return with_tree(flat, gaussians.take(row), tree, ids, flat.source, threads=0)

    def _living(self) -> Array:
        """Ancestors of which a leaf is left."""
        lives = np.zeros(len(self.ancestors), bool)
        above = np.unique(self.of_rows[self.of_rows >= 0])
        while len(above):
            lives[above] = True
            above = np.unique(self.parents[above])
            above = above[above >= 0]
            above = above[~lives[above]]
        return lives


def children_of(parents: Gaussians) -> list[Gaussians]:
    """The children of each parent: the first of all, then the second of all, and so on."""
    n = np.arange(len(parents))
    longest = np.argsort(-parents.log_scales, axis=1, kind="stable")[:, :2]
    axes = matrices_from_quats(parents.quats)  # [n 3 3], columns are the axes of a Gaussian
    scales = np.exp(parents.log_scales.astype(np.float64))
    one, other = (OFFSET * scales[n, k][:, None] * axes[n, :, k] for k in longest.T)
    log_scales = parents.log_scales + np.float32(np.log(SHRINKING))
    return [
        replace(parents, means=(parents.means + a * one + b * other).astype(np.float32), log_scales=log_scales)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]


def _nobody(count: int) -> Int32[Array, "n"]:
    return np.full(count, -1, np.int32)


def _heights(parent: Array) -> Array:
    """Steps from each node down to the lowest leaf below it, the longest way."""
    height, child = np.zeros(len(parent), np.int32), np.flatnonzero(parent >= 0)
    while True:
        higher = height.copy()
        np.maximum.at(higher, parent[child], height[child] + 1)
        if np.array_equal(higher, height):
            return height
        height = higher


def _families(children: Array, parents: Array, height: Array) -> list[Families]:
    """Families of one height after the other, from children in the order of their parents."""
    bounds = np.searchsorted(height, np.arange(1, height[-1] + 2))  # where nodes of each height begin
    found = []
    for begin, end in pairwise(bounds):
        low, high = np.searchsorted(parents, (begin, end))
        start = np.searchsorted(parents[low:high], np.arange(begin, end))
        found.append(Families(int(begin), children[low:high], start.astype(np.int64)))
    return found
