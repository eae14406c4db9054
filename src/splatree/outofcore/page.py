"""One page: consecutive rows of a stored scene, checked and indexed as they come.

A page begins anywhere and ends behind a leaf. An ancestor of a row of a page that lies before the page is an ancestor of its
first row, too. So a page is decided alone, given the few ancestors of its first row: where one of them is drawn, it shadows the
rows up to its end, which are a run at the beginning of the page. Blocks of 256 rows (scene/tree.py) do the same.

The harmonics of a page are three quarters of its bytes. They are read and checked in runs of 64 rows, of which one is drawn.
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

__all__ = ["HARMONIC_ROWS", "Checksums", "Page", "page_of"]

HARMONIC_ROWS = 64
"""Rows whose harmonics are read and checked together: 12 kB at degree 3. Runs of 256 rows touch a sixth more harmonics in a near
view, runs of 16 a twelfth fewer for four times the checksums."""


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
    """Its rows as a forest of their own: subtrees that go on behind the page end with it."""
    blocks: BlockIndex
    """Index of its blocks."""
    depth: UInt8[Array, "n"]
    """Edges from the root, in the file."""
    ids: UInt32[Array, "n"] | None
    """Identity of each row in the file; None: the row number."""
    harmonics: UInt32[Array, "h"] | None
    """CRC-32 of the harmonics of each 64 rows; None: it is not known."""
    is_checked: Bool[Array, "h"]
    """Whether the harmonics of each 64 rows have been checked; the first one who draws one of them does so."""

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

    def check_harmonics(self, rows: Int32[Array, "v"]) -> None:
        """Read the harmonics around rows that are drawn, and check them once.

        Raises:
            FormatError: a value cannot be used, or they are not those that were indexed.
        """
        blocks = np.unique(rows // HARMONIC_ROWS)
        blocks = blocks[~self.is_checked[blocks]]
        for run in np.split(blocks, np.flatnonzero(np.diff(blocks) > 1) + 1) if len(blocks) else ():
            self._check_run(int(run[0]), int(run[-1]) + 1)

    def _check_run(self, first_block: int, end_block: int) -> None:
        first, sh = first_block * HARMONIC_ROWS, self.gaussians.sh
        if not largest_magnitude(sh[first : end_block * HARMONIC_ROWS]) <= SH_MAX:
            rows = np.arange(first, min(end_block * HARMONIC_ROWS, len(self)))
            refuse_unusable(self.gaussians.take(rows), self.where, first_row=self.begin + first)
        wanted = {} if self.harmonics is None else dict(enumerate(self.harmonics[first_block:end_block], first_block))
        for block, checksum in wanted.items():
            begin, end = block * HARMONIC_ROWS, min((block + 1) * HARMONIC_ROWS, len(self))
            if checksum != (found := zlib.crc32(sh[begin:end].data)):
                raise FormatError(
                    f"{self.where}: rows {self.begin + begin} to {self.begin + end}: found harmonics of checksum {found:08x}, "
                    f"wanted {checksum:08x}; the file is damaged or has been replaced"
                )
        self.is_checked[first_block:end_block] = True


@dataclass(frozen=True, eq=False)
class Checksums:
    """What the bytes of a page were when it was indexed."""

    plain: int
    """CRC-32 of all columns but the harmonics."""
    harmonics: UInt32[Array, "h"]
    """CRC-32 of the harmonics of each 64 rows."""

    @staticmethod
    def of(rows: SceneRows) -> "Checksums":
        """Those of rows; reads all of them."""
        sh = rows.gaussians.sh
        runs = [zlib.crc32(sh[first : first + HARMONIC_ROWS].data) for first in range(0, len(rows), HARMONIC_ROWS)]
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
        harmonics=None if checksums is None else checksums.harmonics,
        is_checked=np.zeros(-(-len(rows) // HARMONIC_ROWS), bool),
    )


def _plain_checksum(rows: SceneRows) -> int:
    gaussians = rows.gaussians
    columns = (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities)
    tree = (rows.subtree_end, rows.depth, rows.extents, rows.curves, rows.ids)
    check = 0
    for column in (*columns, *(column for column in tree if column is not None)):
        check = zlib.crc32(column.data, check)
    return check


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
