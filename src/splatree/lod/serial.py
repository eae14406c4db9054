"""The traversal level by level, the baseline that a traversal-free selection is compared with.

From the roots down: of the nodes of one level that were reached, the leaves and the small ones are kept, the others are
replaced by their children. Each level is a handful of array operations, as in LoG (Shuai 2024), whose code takes as many
launches and host synchronisations. It visits the nodes at and above the cut and nothing else, seen or not.

With the rule `cut` the result is the exact cut. With `log-serial` it decides as LoG's code does:

- roots whose centre is out of the image enlarged by half are dropped with all that is below them; nothing below is tested;
- small is R < τ_R, strict; a node whose centre is out of the image enlarged by 0.3, or not beyond the near plane, counts as
  R = 0 and ends the descent (LoG does not test the sign of the depth, and gets radii of mirrored splats behind the camera);
- the descent ends at level 30: what is not kept there is not drawn;
- roots that were hidden by others when all roots were drawn lose their subtree too: pass those that are left as ``roots``.
"""

from dataclasses import dataclass, replace

import numpy as np

from splatree.kernels.cpu.frame import select as cpu
from splatree.kernels.reference.select import in_runs
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Int32

__all__ = ["ChildTable", "child_table_of", "select_serial"]

ROOT_PAD = 0.5
"""Share of the half image by which a root's centre may lie outside (LoG)."""
NODE_PAD = 0.3
"""The same for nodes below the roots: |ndc| ≤ 1.3 (LoG)."""
LAST_LEVEL = 30
"""Depth at which LoG stops."""


@dataclass(frozen=True, eq=False)
class ChildTable:
    """The rows of a tree level by level, children of one node together: what a traversal needs beside the tree."""

    rows: Int32[Array, "n"]
    """All rows by depth, in preorder within a level."""
    num_roots: int
    """Rows of depth 0."""
    first_child: Int32[Array, "n"]
    """For each row of the scene, where in ``rows`` its children start."""
    num_children: Int32[Array, "n"]
    """For each row of the scene, how many there are."""

    def children(self, parents: Array) -> Array:
        """Rows of all children, parent by parent."""
        counts = self.num_children[parents]
        ends = np.cumsum(counts)
        within = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)
        return np.asarray(self.rows[np.repeat(self.first_child[parents], counts) + within])


def child_table_of(tree: GaussianTree) -> ChildTable:
    """The table of children of a tree; 12 bytes a node, built once a scene."""
    rows = np.argsort(tree.depth, kind="stable").astype(np.int32)
    place = np.empty_like(rows)
    place[rows] = np.arange(len(rows), dtype=np.int32)
    first_child = np.zeros(len(tree), np.int32)
    inner = np.flatnonzero(~tree.is_leaf)
    first_child[inner] = place[inner + 1]
    level_start = np.concatenate([[0], np.cumsum(np.bincount(tree.depth))]) if len(tree) else np.zeros(2, int)
    num_children = np.zeros(len(tree), np.int32)
    for above, below, end in zip(level_start, level_start[1:], level_start[2:], strict=False):
        parents = rows[above:below]
        of_child = np.searchsorted(parents, rows[below:end]) - 1  # the last node above that precedes the child
        num_children[parents] = np.bincount(of_child, minlength=len(parents))
    return ChildTable(rows, int(level_start[1]), first_child, num_children)


def select_serial(
    gaussians: Gaussians,
    tree: GaussianTree,
    blocks: BlockIndex | None,
    view: View,
    options: SelectOptions,
    *,
    runs: Int32[Array, "r 2"] | None = None,
    table: ChildTable | None = None,
    roots: Array | None = None,
    threads: int = 0,
) -> tuple[Int32[Array, "v"], int]:
    """Rows drawn, ascending, by the rule `cut` or `log-serial`, and how many nodes were visited.

    Signature as `kernels.cpu.select.select`; ``blocks`` is not used. Radii and the view test come from the same compiled
    functions, so the rule `cut` gives the same set bit for bit.
    """
    table = table or child_table_of(tree)
    as_log = options.rule == "log-serial"
    frontier = table.rows[: table.num_roots] if roots is None else np.asarray(roots, np.int32)
    if as_log:
        frontier = frontier[_centred(gaussians, frontier, view.camera, ROOT_PAD)]
        # Strict: R < τ_R is R ≤ the number before τ_R.
        below = float(np.nextafter(np.float32(options.pixel_error), np.float32(0)))
        options = replace(options, pixel_error=below)
    kept = [np.zeros(0, np.int32)]
    visited = level = 0
    while len(frontier) and not (as_log and level > LAST_LEVEL):
        visited += len(frontier)
        stays = cpu.small(gaussians, tree, frontier, view, options, threads=threads)
        if as_log and level > 0:
            stays |= ~_centred(gaussians, frontier, view.camera, NODE_PAD)
        stays |= table.num_children[frontier] == 0
        kept.append(frontier[stays])
        frontier = table.children(frontier[~stays])
        level += 1
    rows = np.sort(np.concatenate(kept))
    if runs is not None:
        rows = rows[in_runs(rows, runs)]
    seen = cpu.visible(gaussians, tree, rows, view, options, threads=threads)
    return rows[seen], visited


def _centred(gaussians: Gaussians, rows: Array, camera: Camera, pad: float) -> Bool[Array, "v"]:
    """Whether the centres are beyond the near plane and in the image enlarged by ``pad`` half sizes on each side."""
    x, y, z = (gaussians.means[rows] @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.abs(2 * (camera.K[0, 0] * x / z + camera.K[0, 2]) / camera.width - 1)
        down = np.abs(2 * (camera.K[1, 1] * y / z + camera.K[1, 2]) / camera.height - 1)
    return np.asarray((z > camera.near) & (across <= 1 + pad) & (down <= 1 + pad))
