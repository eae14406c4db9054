"""Launches of the selections that ours is measured beside (baselines.cu); same rows, in no order."""

import numpy as np

from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.job import pack_numbers
from splatree.kernels.cuda.plan import Launch, Sizes
from splatree.kernels.cuda.workspace import DeviceScene, Workspace
from splatree.scene.options import SelectOptions
from splatree.scene.tree import GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Int32

__all__ = ["Baselines", "ancestor_table", "child_table"]


class Baselines:
    """The serial traversal and the paper's scheme on the columns of a scene."""

    def __init__(self, device: Device, scene: DeviceScene, tree: GaussianTree) -> None:
        self.device = device
        self._work = Workspace(device, scene)
        n = max(scene.num_rows, 1)
        self._sizes = Sizes(scene.num_blocks, n, 0, 1, False, False, device.num_multiprocessors)
        self._work.fit(self._sizes)
        self._num_roots = int((tree.depth == 0).sum())
        rows, first_child, num_children = child_table(tree)
        self._num_levels = tree.num_levels
        self._work.fill("children", rows[:, None])
        self._work.fill("first_child", first_child[:, None])
        self._work.fill("num_children", num_children[:, None])
        self._work.fill("ancestor_table", ancestor_table(tree).reshape(-1, 1))
        for name in ("frontier_a", "frontier_b", "states"):
            self._work.ensure(name, n)

    @property
    def table_bytes(self) -> dict[str, int]:
        """Bytes of what each scheme needs beside the columns."""
        arrays = self._work.arrays
        return {
            "serial": sum(arrays[name].nbytes for name in ("children", "first_child", "num_children")),
            "paper": arrays["ancestor_table"].nbytes + arrays["states"].nbytes,
        }

    def serial(self, view: View, select: SelectOptions) -> Int32[Array, "v"]:
        """From the roots down, level by level; the host asks after each how many nodes the next has."""
        self.start(view, select)
        self.run_serial()
        return self._rows()

    def paper(self, view: View, select: SelectOptions) -> Int32[Array, "v"]:
        """All nodes at once, each with its row of the ancestor table."""
        self.start(view, select)
        self.run_paper()
        return self._rows()

    def start(self, view: View, select: SelectOptions) -> None:
        """Bring a view to the device."""
        numbers = pack_numbers(view, select, degree=0)
        self._work.write_job(numbers, num_levels=self._num_levels, num_roots=self._num_roots)

    def run_serial(self) -> None:
        """The traversal of the view that was started; waits once a level."""
        self._work.clear()
        count, from_b = self._num_roots, 0
        self._work.run([Launch("serial_roots", -(-count // 256))])
        while count:
            self._work.run([Launch("serial_level", -(-count // 256), count << 1 | from_b)])
            counts = self._work.counts()
            self._work.set_counts(num_selected=counts["num_selected"])
            count, from_b = counts["num_frontier"], 1 - from_b

    def run_paper(self) -> None:
        """The paper's scheme for the view that was started."""
        self._work.clear()
        blocks = -(-self._sizes.rows // 256)
        self._work.run([Launch("paper_small", blocks), Launch("paper_filter", blocks)])

    def _rows(self) -> Int32[Array, "v"]:
        return np.asarray(self._work.arrays["rows"].numpy(self._work.counts()["num_selected"])[:, 0])


def child_table(tree: GaussianTree) -> tuple[Int32[Array, "n"], Int32[Array, "n"], Int32[Array, "n"]]:
    """Rows level by level, and for each row where its children start there and how many it has: 12 bytes a node."""
    rows = np.argsort(tree.depth, kind="stable").astype(np.int32)
    place = np.empty_like(rows)
    place[rows] = np.arange(len(rows), dtype=np.int32)
    inner = np.flatnonzero(~tree.is_leaf)
    first_child = np.zeros(len(tree), np.int32)
    first_child[inner] = place[inner + 1]
    num_children = np.zeros(len(tree), np.int32)
    parents = parents_of(tree)
    num_children[:] = np.bincount(parents[parents >= 0], minlength=len(tree))
    return rows, first_child, num_children


def ancestor_table(tree: GaussianTree) -> Int32[Array, "n l"]:
    """The ancestors of each row, root first, -1 behind the last: 4 bytes a level and node."""
    table = np.full((len(tree), max(tree.num_levels, 1)), -1, np.int32)
    parents = parents_of(tree)
    for depth in range(1, tree.num_levels):
        rows = np.flatnonzero(tree.depth == depth)
        table[rows, : depth - 1] = table[parents[rows], : depth - 1]
        table[rows, depth - 1] = parents[rows]
    return table


def parents_of(tree: GaussianTree) -> Int32[Array, "n"]:
    """The parent of each row, -1 of a root: the last row before it that is one level higher."""
    parents = np.full(len(tree), -1, np.int32)
    above = np.flatnonzero(tree.depth == 0)
    for depth in range(1, tree.num_levels):
        rows = np.flatnonzero(tree.depth == depth)
        parents[rows] = above[np.searchsorted(above, rows) - 1]
        above = rows
    return parents
