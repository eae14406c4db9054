"""One page: consecutive rows of a stored scene, checked and indexed as they come.

A page begins anywhere and ends behind a leaf. An ancestor of a row of a page that lies before the page is an ancestor of its
first row, too. So a page is decided alone, given the few ancestors of its first row: where one of them is drawn, it shadows the
rows up to its end, which are a run at the beginning of the page. Blocks of 256 rows (scene/tree.py) do the same.

A selection reads neither harmonics, three quarters of the bytes of a page, nor how nodes follow the pixel. What drawing alone
reads is read and checked in runs of 64 rows, of which one is drawn.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from splatree.errors import FormatError, ShapeError
from splatree.io.check import SH_MAX, refuse_unusable
from splatree.io.formats.splatree.rows import SceneRows
from splatree.kernels.cpu.codec.columns import largest_magnitude
from splatree.kernels.cpu.frame import select as kernel
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.maths.forests import depth_from_ends
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Int32, Int64, UInt8, UInt32

__all__ = ["DRAWN_ROWS", "Checksums", "Page", "page_of"]

DRAWN_ROWS = 64
"""Rows of which is read and checked together what drawing alone reads: 13 kB at degree 3. Runs of 256 rows touch a sixth more
harmonics in a near view, runs of 16 a twelfth fewer for four times the checksums."""


@dataclass(frozen=True, eq=False)
class Page:
    """Rows of a stored scene that are ready for a selection."""

    where: str
    """The file."""
    begin: int
    """Row of the file that it begins with."""
    gaussians: Gaussians
    """Its Gaussians, mapped; harmonics are not checked yet."""
    tree: GaussianTree
    """Its rows as a forest of their own: subtrees that go on behind the page end with it; curves are not checked yet."""
    blocks: BlockIndex
    """Index of its blocks."""
    depth: UInt8[Array, "n"]
    """Edges from the root, in the file."""
    ids: UInt32[Array, "n"] | None
    """Identity of each row in the file; None: the row number."""
    drawn: UInt32[Array, "h"] | None
    """`Checksums.drawn`; None: they are not known."""
    is_checked: Bool[Array, "h"]
    """Whether what is drawn of each 64 rows has been checked; the first one who draws one of them does so."""

    def __len__(self) -> int:
        return len(self.tree)

    def select(self, packed: kernel.PackedCut, shadow: int, *, threads: int = 0) -> tuple[Int32[Array, "v"], int]:
        """Rows drawn, counted in the page, ascending, by the rule `cut`, and how many were looked at.

        Rows of the file before ``shadow`` are below a node that is drawn.
        """
        first = max(shadow - self.begin, 0)
        if first >= len(self):
            return np.zeros(0, np.int32), 0
        runs = None if first == 0 else np.array([[first, len(self)]], np.int32)
        return kernel.select_packed(self.gaussians, self.tree, self.blocks, packed, runs=runs, threads=threads)

    def visible(self, rows: Int32[Array, "v"], view: View, options: SelectOptions) -> Bool[Array, "v"]:
        """Which of the rows can be seen, as `select` decides it."""
        return kernel.visible(self.gaussians, self.tree, rows, view, options, threads=1)

    def small(self, rows: Int32[Array, "v"], view: View, options: SelectOptions) -> Bool[Array, "v"]:
        """Which of the rows are at most as large as the pixel error."""
        return kernel.small(self.gaussians, self.tree, rows, view, options, threads=1)

    @property
    def drawn_bytes(self) -> int:
        """Bytes of what drawing alone reads."""
        return self.gaussians.sh.nbytes + (0 if self.tree.curves is None else self.tree.curves.nbytes)

    def check_drawn(self, rows: Int32[Array, "v"]) -> None:
        """Read the harmonics and curves around rows that are drawn, and check them once.

        Raises:
            FormatError: a value cannot be used, or they are not those that were indexed.
        """
        runs = np.unique(rows // DRAWN_ROWS)
        runs = runs[~self.is_checked[runs]]
        for together in np.split(runs, np.flatnonzero(np.diff(runs) > 1) + 1) if len(runs) else ():
            self._check_runs(int(together[0]), int(together[-1]) + 1)

    def _check_runs(self, first_run: int, end_run: int) -> None:
        first, sh = first_run * DRAWN_ROWS, self.gaussians.sh
        if not largest_magnitude(sh[first : end_run * DRAWN_ROWS]) <= SH_MAX:
            rows = np.arange(first, min(end_run * DRAWN_ROWS, len(self)))
            refuse_unusable(self.gaussians.take(rows), self.where, first_row=self.begin + first)
        wanted = {} if self.drawn is None else dict(enumerate(self.drawn[first_run:end_run], first_run))
        for run, checksum in wanted.items():
            begin, end = run * DRAWN_ROWS, min((run + 1) * DRAWN_ROWS, len(self))
            if checksum != (found := _drawn_checksum(sh, self.tree.curves, begin)):
                columns = "harmonics" if self.tree.curves is None else "harmonics and curves"
                raise FormatError(
                    f"{self.where}: rows {self.begin + begin} to {self.begin + end}: found {columns} of checksum {found:08x}, "
                    f"wanted {checksum:08x}; the file is damaged or has been replaced"
                )
        self.is_checked[first_run:end_run] = True


@dataclass(frozen=True, eq=False)
class Checksums:
    """What the bytes of a page were when it was indexed."""

    plain: int
    """CRC-32 of all columns but the harmonics and the curves."""
    drawn: UInt32[Array, "h"]
    """CRC-32 of the harmonics and the curves of each 64 rows."""

    @staticmethod
    def of(rows: SceneRows) -> "Checksums":
        """Those of rows; reads all of them."""
        sh, curves = rows.gaussians.sh, rows.curves
        runs = [_drawn_checksum(sh, curves, first) for first in range(0, len(rows), DRAWN_ROWS)]
        return Checksums(_plain_checksum(rows), np.array(runs, np.uint32))


def page_of(rows: SceneRows, file: str, path: Int64[Array, "a"], *, checksums: Checksums | None = None) -> Page:
    """Check that rows are a part of a tree, and index them.

    Args:
        rows: their values have been checked; the last one is a leaf.
        file: named in errors.
        path: where the subtrees of the ancestors of the first row end, from the root down.
        checksums: those of the rows when they were indexed; None: they are not compared.

    Raises:
        FormatError: the rows are no part of a tree, or not those that were indexed.
    """
    begin, end = rows.begin, rows.begin + len(rows)
    where = f"{file}: rows {begin} to {end}"
    if checksums is not None and checksums.plain != (found := _plain_checksum(rows)):
        raise FormatError(
            f"{where}: found checksum {found:08x}, wanted {checksums.plain:08x}; the file is damaged or has been replaced"
        )
    ends = np.minimum(rows.subtree_end, end) - np.int32(begin)
    try:
        tree = GaussianTree(ends, depth_from_ends(ends), rows.extents, rows.curves)
    except ShapeError as error:
        raise FormatError(f"{where}: {error}; the file is damaged") from error
    _check_path(rows, tree, path, where)
    return Page(
        where=file,
        begin=begin,
        gaussians=rows.gaussians,
        tree=tree,
        blocks=index_blocks(rows.gaussians, tree, threads=1),
        depth=rows.depth,
        ids=rows.ids,
        drawn=None if checksums is None else checksums.drawn,
        is_checked=np.zeros(-(-len(rows) // DRAWN_ROWS), bool),
    )


def _plain_checksum(rows: SceneRows) -> int:
    gaussians = rows.gaussians
    columns = (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities)
    tree = (rows.subtree_end, rows.depth, rows.extents, rows.ids)
    check = 0
    for column in (*columns, *(column for column in tree if column is not None)):
        check = zlib.crc32(column.data, check)
    return check


def _drawn_checksum(sh: Array, curves: Array | None, first: int) -> int:
    """Of the run that begins with a row."""
    check = zlib.crc32(sh[first : first + DRAWN_ROWS].data)
    return check if curves is None else zlib.crc32(curves[first : first + DRAWN_ROWS].data, check)


def _check_path(rows: SceneRows, tree: GaussianTree, path: Int64[Array, "a"], where: str) -> None:
    """Refuse rows that are not below the path, or not as deep as they say."""
    n, end = len(rows), rows.begin + len(rows)
    is_nested = np.all(np.diff(path) <= 0)
    for stop in path[path < end] - rows.begin:
        is_nested &= bool(np.all(rows.subtree_end[:stop] <= rows.begin + stop))
    beyond, longest = rows.subtree_end[rows.subtree_end > end], path[path >= end]
    is_nested &= bool(np.all(np.diff(beyond) <= 0) and (beyond[:1] <= longest[-1:]).all())
    above = np.searchsorted(-path, -(np.arange(n) + rows.begin), side="left")  # subtrees that have not ended
    if not is_nested or not np.array_equal(rows.depth, tree.depth + above):
        raise FormatError(f"{where}: found subtrees and depths that are no part of one tree; the file is damaged")
