"""The table of the pages of a store: what is known of a page before it is read.

A page has a box around what it draws, the largest standard deviation in it, the same of each of its blocks of 256 rows, and the
ancestors of its first row, which are kept with the table. So most pages of a view are left out unread: all their blocks are out
of the image, or below a node that is drawn. A block also has the steps of `BlockIndex`: a coarse node is wide, but a near view
does not draw it.

A folder of parts is a store of several files. Leaves of the crown are copies of roots of parts, its *portals*; all portals are
numbered, part by part. A page of a part knows the numbers of the roots that it belongs to. A page of the crown has the box of its
inner nodes alone: what is below its portals has pages of its own (io/pages/index.py).

Cost: 60 bytes a page of 1 MB, 88 bytes a block of 60 kB. Making the table reads everything but the harmonics, once.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from splatree.constants import BLOCK_ROWS, BLOCK_STEPS
from splatree.errors import FormatError
from splatree.io.formats.splatree.fields import column_types
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows, StoredScene
from splatree.io.pages.page import Checksums, Page, page_of
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.shapes import Array, Float32, Int32, Int64, UInt8, check_fields

__all__ = ["PAGE_BYTES", "PageTable", "row_bytes_of", "table_of"]

PAGE_BYTES = 1_000_000
"""Bytes of a page: smaller pages fit views more closely, larger ones take fewer steps; benchmarks/paging.py compares."""

FETCHED_PAGES = 32
"""Pages of an object of a store that are fetched together while the table is made."""

DEEPEST = 255
"""A leaf follows each row within so many rows."""


@dataclass(frozen=True, eq=False)
class PageTable:
    """Pages of one or more files, and the ancestors of their first rows."""

    begin: Int32[Array, "p"]
    """Row of its file that each page begins with."""
    end: Int32[Array, "p"]
    """One past the last row."""
    lower: Float32[Array, "p 3"]
    """Smallest coordinates of the means that a page stands for, world units."""
    upper: Float32[Array, "p 3"]
    """Largest coordinates."""
    leaf_scales: Float32[Array, "p"]
    """Largest standard deviation as in `BlockIndex.leaf_scales`, world units."""
    block_lower: Float32[Array, "b 3"]
    """Smallest coordinates of the means in each block of 256 rows of each page, world units (`BlockIndex.lower`)."""
    block_upper: Float32[Array, "b 3"]
    """Largest coordinates."""
    block_step_extents: Float32[Array, "b s"]
    """Extents as in `BlockIndex.step_extents`, world units; 0 alone in tables of before."""
    block_step_scales: Float32[Array, "b s"]
    """Standard deviations as in `BlockIndex.step_scales`, world units."""
    first_root: Int64[Array, "p"]
    """Number of the first root that begins in each page."""
    ancestor_start: Int32[Array, "p+1"]
    """Ancestors of the first row of page ``i``: ``ancestors[ancestor_start[i] : ancestor_start[i + 1]]``."""
    ancestors: Int32[Array, "a"]
    """From the root down; each is a row of the columns below."""
    rows: Int32[Array, "c"]
    """Row of its file of each node that is an ancestor of a page."""
    subtree_end: Int32[Array, "c"]
    """Where its subtree ends, in the file."""
    means: Float32[Array, "c 3"]
    """Its mean, world units."""
    quats: Float32[Array, "c 4"]
    """Its quaternion."""
    log_scales: Float32[Array, "c 3"]
    """Logarithms of its standard deviations."""
    extents: Float32[Array, "c"]
    """Its extent, world units."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.begin)

    @property
    def block_start(self) -> Int64[Array, "q"]:
        """The first block of each page, and behind the last one the number of blocks."""
        return np.concatenate([[0], np.cumsum(-(-(self.end - self.begin) // BLOCK_ROWS))])

    def path(self, page: int) -> Int64[Array, "a"]:
        """Where the subtrees of the ancestors of a page end, from the root down."""
        of_page = self.ancestors[self.ancestor_start[page] : self.ancestor_start[page + 1]]
        return self.subtree_end[of_page].astype(np.int64)

    @property
    def gaussians(self) -> Gaussians:
        """The ancestors as Gaussians, as far as their size on the screen depends on them."""
        n = len(self.rows)
        logits, sh = np.zeros(n, np.float32), np.zeros((n, 1, 3), np.float32)
        return Gaussians(self.means, self.quats, self.log_scales, logits, sh)

    @property
    def tree(self) -> GaussianTree:
        """The extents of the ancestors."""
        n = len(self.rows)
        return GaussianTree(np.arange(1, n + 1, dtype=np.int32), np.zeros(n, np.uint8), self.extents)

    @staticmethod
    def joined(tables: Iterable["PageTable"]) -> "PageTable":
        """The pages of all tables, one after the other; roots are numbered on, rows stay those of their files."""
        tables = list(tables)
        columns = {f.name: np.concatenate([getattr(table, f.name) for table in tables]) for f in fields(PageTable)}
        num_ancestors = np.cumsum([0, *(len(table.ancestors) for table in tables)])
        starts = [t.ancestor_start[:-1] + first for t, first in zip(tables, num_ancestors[:-1], strict=True)]
        columns["ancestor_start"] = np.concatenate([*starts, num_ancestors[-1:]]).astype(np.int32)
        num_nodes = np.cumsum([0, *(len(table.rows) for table in tables)])
        columns["ancestors"] = np.concatenate(
            [t.ancestors + first for t, first in zip(tables, num_nodes[:-1], strict=True)]
        ).astype(np.int32)
        return PageTable(**columns)


@dataclass(frozen=True, eq=False)
class FilePages:
    """What a pass over a file finds."""

    table: PageTable
    """Its pages; roots are numbered from 0."""
    num_leaves: int
    """Leaves."""
    largest_id: int
    """Largest identity of a leaf; −1 without any."""
    root_sizes: Int32[Array, "r"]
    """Rows below each root, and the root itself."""
    root_levels: UInt8[Array, "r"]
    """Largest depth of these rows."""
    checksums: list[Checksums]
    """Of each page; empty if they were not wanted."""


def row_bytes_of(head: SceneHead) -> int:
    """Bytes of a row of such a scene."""
    types = column_types(1, (head.sh_degree + 1) ** 2, has_ids=head.has_ids, has_curves=head.has_curves)
    return sum(dtype.itemsize * math.prod(shape) for dtype, shape in types.values())


def table_of(
    stored: StoredScene,
    *,
    portals: bool = False,
    checksums: bool = False,
    look: Callable[[Page], None] | None = None,
    advance: Callable[[float], None] = lambda rows: None,
) -> FilePages:
    """Go through a file page by page and note what a selection has to know of each.

    Args:
        stored: the file.
        portals: whether its leaves are copies of roots of parts, whose size is that of pages of the parts.
        checksums: also note checksums, for which harmonics have to be read.
        look: is given each page, for which harmonics are mapped.
        advance: is told how many rows were gone through.

    Raises:
        FormatError: a value cannot be used, or the rows are no tree.
    """
    noted, path = _Noted(portals, checksums), np.zeros(0, np.int64)
    for rows in _pages_of(stored, harmonics=False if checksums or look is not None else None):
        page = page_of(rows, str(stored.file.path), path)
        if look is not None:
            look(page)
        path = noted.add(rows, page)
        stored.forget(page.begin, page.begin + len(page))
        advance(float(len(page)))
    return noted.pages()


def _pages_of(stored: StoredScene, *, harmonics: bool | None) -> Iterator[SceneRows]:
    """The rows of one page after the other; of an object of a store, several are fetched together."""
    page_rows, n = max(PAGE_BYTES // row_bytes_of(stored.head), 1), len(stored)
    fetched_rows = page_rows * FETCHED_PAGES if stored.file.is_elsewhere else page_rows
    held = stored.rows(0, 0, harmonics=harmonics)
    begin = 0
    while begin < n:
        end = _end_of_page(held, stored, begin, page_rows)
        if end > held.begin + len(held):
            held = stored.rows(begin, max(end, min(begin + fetched_rows, n)), harmonics=harmonics)
        yield held.part(begin, end)
        begin = end


class _Noted:
    """The table of a file as it grows."""

    def __init__(self, has_portals: bool, with_checksums: bool) -> None:
        self._has_portals = has_portals
        self._checksums: list[Checksums] | None = [] if with_checksums else None
        self._pages: list[tuple[int, int, Array, Array, float, int]] = []
        self._blocks: list[tuple[Array, Array, Array, Array]] = []
        self._ancestors: list[list[int]] = []
        self._nodes: list[tuple[int, int, Array, Array, Array, float]] = []
        self._path: list[int] = []  # numbers of nodes
        self._roots: list[tuple[Array, Array]] = []
        self._num_roots = self._num_leaves = 0
        self._largest_id = -1

    def add(self, rows: SceneRows, page: Page) -> Int64[Array, "a"]:
        """Take the next page; returns where the subtrees end that go on behind it."""
        begin, end = page.begin, page.begin + len(page)
        blocks = _blocks_of_inner(page) if self._has_portals else page.blocks
        lower, upper = blocks.group_lower.min(axis=0), blocks.group_upper.max(axis=0)
        self._pages.append((begin, end, lower, upper, float(blocks.group_leaf_scales.max()), self._num_roots))
        self._blocks.append((blocks.lower, blocks.upper, blocks.step_extents, blocks.step_scales))
        if self._checksums is not None:
            self._checksums.append(Checksums.of(rows))
        self._ancestors.append(list(self._path))
        self._add_roots(rows)
        leaves = page.tree.is_leaf
        self._num_leaves += int(leaves.sum())
        ids = rows.ids[leaves] if rows.ids is not None else np.flatnonzero(leaves) + begin
        self._largest_id = max(self._largest_id, int(ids.max(initial=0)))
        self._path = [node for node in self._path if self._nodes[node][1] > end]
        for i in np.flatnonzero(rows.subtree_end > end):
            self._path.append(len(self._nodes))
            g, stop = rows.gaussians, int(rows.subtree_end[i])
            self._nodes.append((begin + int(i), stop, g.means[i], g.quats[i], g.log_scales[i], float(rows.extents[i])))
        return np.array([self._nodes[node][1] for node in self._path], np.int64)

    def _add_roots(self, rows: SceneRows) -> None:
        roots = np.flatnonzero(rows.depth == 0).astype(np.int32)
        start = roots if len(roots) and roots[0] == 0 else np.concatenate([[0], roots])
        levels = np.maximum.reduceat(rows.depth, start)
        if len(start) > len(roots):  # the subtree of a root before goes on
            last = next(levels for _, levels in reversed(self._roots) if len(levels))
            last[-1], levels = max(last[-1], levels[0]), levels[1:]
        self._roots.append((rows.subtree_end[roots] - np.int32(rows.begin) - roots, levels))
        self._num_roots += len(roots)

    def pages(self) -> FilePages:
        """All that was noted."""
        begin, end, lower, upper, scales, roots = zip(*self._pages, strict=True) if self._pages else [()] * 6
        rows, stops, means, quats, log_scales, extents = zip(*self._nodes, strict=True) if self._nodes else [()] * 6
        points, steps = np.zeros((0, 3), np.float32), np.zeros((0, BLOCK_STEPS), np.float32)
        block_columns = (
            np.concatenate(column) for column in zip((points, points, steps, steps), *self._blocks, strict=True)
        )
        block_lower, block_upper, step_extents, step_scales = block_columns
        table = PageTable(
            begin=np.array(begin, np.int32),
            end=np.array(end, np.int32),
            lower=np.array(lower, np.float32).reshape(-1, 3),
            upper=np.array(upper, np.float32).reshape(-1, 3),
            leaf_scales=np.array(scales, np.float32),
            block_lower=block_lower,
            block_upper=block_upper,
            block_step_extents=step_extents,
            block_step_scales=step_scales,
            first_root=np.array(roots, np.int64),
            ancestor_start=np.cumsum([0, *map(len, self._ancestors)]).astype(np.int32),
            ancestors=np.array([node for path in self._ancestors for node in path], np.int32),
            rows=np.array(rows, np.int32),
            subtree_end=np.array(stops, np.int32),
            means=np.array(means, np.float32).reshape(-1, 3),
            quats=np.array(quats, np.float32).reshape(-1, 4),
            log_scales=np.array(log_scales, np.float32).reshape(-1, 3),
            extents=np.array(extents, np.float32),
        )
        none = np.zeros(0, np.int32), np.zeros(0, np.uint8)
        sizes, levels = (np.concatenate(column) for column in zip(none, *self._roots, strict=True))
        return FilePages(
            table=table,
            num_leaves=self._num_leaves,
            largest_id=self._largest_id,
            root_sizes=sizes,
            root_levels=levels,
            checksums=self._checksums or [],
        )


def _blocks_of_inner(page: Page) -> BlockIndex:
    """The index of the blocks of a page for which its leaves are points."""
    log_scales = np.where(page.tree.is_leaf[:, None], np.float32(-np.inf), page.gaussians.log_scales)
    return index_blocks(replace(page.gaussians, log_scales=log_scales), page.tree, threads=1)


def _end_of_page(held: SceneRows, stored: StoredScene, begin: int, page_rows: int) -> int:
    """The end of a page of at least so many rows, the first behind a leaf; or the end of the file.

    It is looked for among the rows that are held, and in the file where these end before.
    """
    first, n = begin + page_rows - 1, len(stored)
    if first >= n - 1:
        return n
    last = min(first + DEEPEST + 1, n)
    if last <= held.begin + len(held):
        ends = held.subtree_end[first - held.begin : last - held.begin]
    else:
        ends = stored.file.rows("tree.subtree_end", first, last)
    is_leaf = ends == first + 1 + np.arange(len(ends))
    if not is_leaf.any():
        raise FormatError(
            f"{stored.file.path}: rows {first} to {first + len(ends)}: found no leaf, wanted one at most {DEEPEST} levels below "
            "each node; the file is damaged"
        )
    return first + 1 + int(np.argmax(is_leaf))
