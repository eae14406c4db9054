"""The nodes of a ``.rad`` with levels: their order, and the links between them.

Node 0 is the root; several roots get a node above them. The order decides how many chunks a viewer loads for a picture
(`splatree.kernels.reference.paging`): the children of a node follow each other, and a chunk holds the large nodes of one region.
Views of 100,000 nodes of a scene of millions need a third of the chunks that they would need if the nodes stood breadth-first.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.errors import InputError
from splatree.io.opacities import opacities_from_logits
from splatree.kernels.cpu.build.merge import merge
from splatree.kernels.cpu.codec.paging import page_order
from splatree.maths.forests import links_from_preorder
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.scene import Scene
from splatree.scene.thinning import Groups, MergeOptions
from splatree.shapes import Array, Float32, Int32, UInt16, UInt32, check_fields

__all__ = ["Nodes", "log_sizes", "nodes_of"]

_CHILDREN_MAX = 65535
"""Children are counted in 16 bits."""


@dataclass(frozen=True, eq=False)
class Links:
    """The links of the nodes of one chunk, as the file has them."""

    num_children: UInt16[Array, "m"]
    """Children of each node."""
    first_child: UInt32[Array, "m"]
    """Node of the first child; 0 for a leaf."""
    extents: Float32[Array, "i"] | None
    """Extents of the inner nodes; None: the reader makes balls around what is below."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Nodes:
    """A tree as a ``.rad`` numbers it."""

    rows: Int32[Array, "n"]
    """Row of the scene of each node; of the nodes after the root alone, where the root was made to join several."""
    num_children: Int32[Array, "m"]
    """Children of each node."""
    first_child: UInt32[Array, "m"]
    """Node of the first child; 0 for a leaf."""
    joined_root: Gaussians
    """The node made to join several roots; empty if the scene has one."""
    extents: Float32[Array, "m"] | None
    """Extent of each node; None: balls around what is below, which the reader makes."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.num_children)

    def gaussians(self, scene: Scene, begin: int, end: int) -> Gaussians:
        """Nodes ``begin`` to ``end``, of the scene that these are the nodes of."""
        above = len(self.joined_root)
        part = scene.gaussians.take(self.rows[max(begin - above, 0) : max(end - above, 0)])
        return Gaussians.concatenate([self.joined_root, part]) if above and begin == 0 else part

    def links(self, begin: int, end: int) -> Links:
        """Links of the nodes ``begin`` to ``end``."""
        num_children = self.num_children[begin:end]
        extents = None if self.extents is None else self.extents[begin:end][num_children > 0]
        return Links(num_children.astype(np.uint16), self.first_child[begin:end], extents)


def nodes_of(scene: Scene, path: Path) -> Nodes:
    """Number the nodes of a scene with levels.

    Raises:
        InputError: a node has more than 65,535 children.
    """
    g, tree = scene.gaussians, scene.tree
    links = links_from_preorder(tree.depth)
    roots = np.flatnonzero(tree.depth == 0)
    joined = _joined(g, roots) if len(roots) > 1 else Gaussians.empty(g.sh_degree)
    above = len(joined)
    largest_family = max(len(roots) if above else 0, int(links.num_children.max()))
    if largest_family > _CHILDREN_MAX:
        raise InputError(
            f"{path.name}: found a node of {largest_family} children, wanted at most {_CHILDREN_MAX}; build the levels with "
            "a smaller growth or fewer roots"
        )
    rows = page_order(g.means, log_sizes(g), tree.subtree_end, above)
    number = np.zeros(len(rows) + 1, np.uint32)
    number[rows] = np.arange(above, above + len(rows), dtype=np.uint32)
    num_children = np.empty(len(rows), np.int32)
    num_children[links.row_from_node] = links.num_children
    num_children = num_children[rows]
    first_child = np.where(num_children > 0, number[rows + 1], 0).astype(
        np.uint32
    )  # it is the next row of the preorder
    has_extents = tree.record is not None and tree.record.profile in EXTENT_PROFILES
    extents = tree.extents[rows] if has_extents else None
    if above:
        if extents is not None:
            extents = np.append(tree.extents[roots].max(), extents)
        num_children = np.append(np.int32(len(roots)), num_children)
        first_child = np.append(np.uint32(1), first_child)
    return Nodes(rows, num_children, first_child, joined, extents)


def log_sizes(g: Gaussians) -> Float32[Array, "n"]:
    """Logarithm of the mean of each Gaussian's three standard deviations, by which Spark 2.2 chooses nodes."""
    largest = g.log_scales.max(axis=1)
    ratios = np.exp(g.log_scales - largest[:, None])
    return np.asarray(largest + np.log(ratios.sum(axis=1) / 3), np.float32)


def _joined(g: Gaussians, roots: Array) -> Gaussians:
    """The moment merge of the roots, weighted by opacity."""
    members = g.take(roots)
    every = np.arange(len(roots), dtype=np.int32)
    groups = Groups(every[:1], np.zeros_like(every), np.array([0, len(roots)], np.int64), every)
    weights = np.maximum(opacities_from_logits(members.logit_opacities), np.float32(1e-6))
    return merge(members, groups, weights, MergeOptions(weight="opacity", opacity="standard"))
