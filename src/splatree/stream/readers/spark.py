"""What Spark 2.2 draws of a tree, and which chunks of a ``.rad`` it loads for that (its ``lod_tree.rs``).

Spark begins with the root and opens the node that looks largest, again and again: the node's children are drawn in its place.
A node's size in the view is ``2 σ / distance · foveation``. σ is the mean of its three standard deviations. Foveation is 1 within
45° of the view's axis, falls to 0.4 at 60°, to 0.2 at 90° and stays there. Spark stops when the next family would pass the
budget, or when nothing looks larger than a pixel. The chunks that hold the children of an opened node have to be loaded.

Here a node may be larger than its parent, and then is opened right after it. So the order of opening is the order of the least
size on the path from the root. Spark keeps sizes and centres in half precision, here they are exact.
"""

from dataclasses import dataclass

import numpy as np

from splatree.io.formats.rad.nodes import Nodes, log_sizes
from splatree.kernels.reference.paging import PAGE_ROWS
from splatree.maths.forests import parents_by_level
from splatree.scene.cameras import Camera
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64, Int32, Int64, check_fields

__all__ = ["SparkView", "chunks_loaded", "select_spark"]

_INNER_DEG, _OUTER_DEG = 45.0, 60.0
_AT_OUTER, _BEHIND = 0.4, 0.2


@dataclass(frozen=True, eq=False)
class SparkView:
    """What Spark chooses in a view."""

    drawn: Int32[Array, "v"]
    """Rows that are drawn, ascending."""
    opened: Int32[Array, "m"]
    """Rows whose children stand for them, in the order of opening."""

    def __post_init__(self) -> None:
        check_fields(self)


def select_spark(scene: Scene, camera: Camera, budget: int, *, least_px: float = 1.0) -> SparkView:
    """Choose rows for at most ``budget`` drawn; nodes that look smaller than ``least_px`` are not opened."""
    tree, n = scene.tree, len(scene)
    parents = np.full(n, -1, np.int32)
    looks = _sizes_in_view(scene, camera)
    for rows, above in parents_by_level(tree.depth):
        parents[rows] = above
        looks[rows] = np.minimum(looks[rows], looks[above])
    num_children = np.bincount(parents[parents >= 0], minlength=n)
    inner = np.flatnonzero(num_children > 0)
    inner = inner[np.argsort(-looks[inner], kind="stable")]  # of equals a parent is first: preorder
    inner = inner[looks[inner] * float(camera.K[1, 1]) > least_px]
    drawn = np.count_nonzero(parents < 0) + np.cumsum(num_children[inner] - 1)
    opened = inner[: int(np.searchsorted(drawn, budget, side="right"))]
    is_open = np.zeros(n + 1, bool)  # the parent of a root, row −1, is open
    is_open[opened] = is_open[-1] = True
    return SparkView(
        np.flatnonzero(is_open[parents] & ~is_open[:-1]).astype(np.int32),
        opened.astype(np.int32),
    )


def chunks_loaded(nodes: Nodes, view: SparkView, *, page_rows: int = PAGE_ROWS) -> Int64[Array, "p"]:
    """Numbers of the chunks that hold the root and the children of opened nodes, ascending."""
    above = len(nodes.joined_root)
    number = np.empty(len(nodes.rows), np.int64)
    number[nodes.rows] = np.arange(above, above + len(nodes.rows))
    opened = number[view.opened]
    if above:
        opened = np.append(0, opened)
    first = nodes.first_child[opened].astype(np.int64)
    last = first + nodes.num_children[opened] - 1
    return np.unique(np.concatenate([[0], first // page_rows, last // page_rows]))


def _sizes_in_view(scene: Scene, camera: Camera) -> Float64[Array, "n"]:
    """2 σ / distance · foveation of each row."""
    sizes = 2 * np.exp(log_sizes(scene.gaussians).astype(np.float64))
    away = scene.gaussians.means - camera.position
    distances = np.maximum(np.sqrt(np.einsum("ij,ij->i", away, away)), 1e-6)
    cosines = away @ camera.camera_from_world[2, :3] / distances
    bends = [-1.0, 0.0, np.cos(np.radians(_OUTER_DEG)), np.cos(np.radians(_INNER_DEG)), 1.0]
    return np.asarray(sizes / distances * np.interp(cosines, bends, [_BEHIND, _BEHIND, _AT_OUTER, 1.0, 1.0]))
