"""The cut of a view by pages: the rows of `select` on the whole tree, from the pages that the view needs.

1. Nodes of the table that are ancestors of pages are asked whether they stop: a page is skipped where one shadows all of it.
2. A page is skipped where its box, or that of each of its blocks, is out of the image, by the test that the selection has for
   blocks (kernels/shared/select.h).
3. What is left is loaded, and selects its own rows.

In a folder, the crown is read first: its pages in which an inner node may be seen, and those that hold portals of pages of parts
that step 2 leaves. Inner nodes are drawn as they are. A leaf of the crown that nothing shadows is an open portal: the root of a
part that it is a copy of, and what is below, may be drawn. Pages of parts without an open portal are skipped; of the others, rows
below closed portals are dropped. docs/explanation/out-of-core.md.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from splatree.constants import BLOCK_ROWS, SIGMAS
from splatree.io.pages.index import StoreIndex
from splatree.io.pages.page import Page
from splatree.io.pages.table import PageTable
from splatree.kernels.cpu.frame import select as kernel
from splatree.scene.options import SelectOptions
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float32, Int32, Int64, check_fields

__all__ = ["Cut", "cut_at"]

MARGIN, DISTANCE_MOST = 1.0001, 1e15
"""As in kernels/shared/select.h: what keeps bounds apart from rounding, and distances whose squares float32 cannot hold."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Rows that are drawn, and where they are."""

    rows: Int32[Array, "v"]
    """Rows of the whole tree, ascending."""
    pages: Int32[Array, "v"]
    """The page that each is in."""
    places: Int32[Array, "v"]
    """Its row in the page."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.rows)

    def by_page(self) -> Iterator[tuple[int, Int64[Array, "w"]]]:
        """Each page that rows are in, and which of the rows."""
        order = np.argsort(self.pages, kind="stable")
        ends = np.flatnonzero(np.diff(self.pages[order])) + 1
        for rows in np.split(order, ends) if len(order) else ():
            yield int(self.pages[rows[0]]), rows


def cut_at(
    index: StoreIndex, page_of: Callable[[int, int], Page], view: View, options: SelectOptions, *, threads: int = 0
) -> tuple[Cut, int]:
    """The cut of a view at the pixel error of the options, and how many rows were looked at.

    Args:
        index: of the store.
        page_of: loads a page, given its number and one past the last of the pages that are asked for next, without a gap.
        view: the view.
        options: of the rule `cut`, with the profile of the levels; a budget is not looked at.
        threads: threads to use; 0: all.
    """
    asked = _Asked(index, page_of, view, options, threads)
    if not index.has_parts:
        for run in _runs(asked.is_open):
            asked.take_file(*run)
        return asked.cut()
    num_own = index.num_own
    for run in _runs(asked.is_open[:num_own] | asked.holds_portals()):
        asked.take_crown(*run)
    rows = asked.portals()
    table = index.table
    # A page belongs to the roots that begin in it, and to the one before if it begins within a subtree.
    first = table.first_root[num_own:] - (np.diff(table.ancestor_start)[num_own:] > 0)
    last = np.append(table.first_root[num_own + 1 :], index.num_roots)
    num_open = np.concatenate([[0], np.cumsum(rows >= 0)])
    for page, end in _runs(asked.is_open[num_own:] & (num_open[last] > num_open[first])):
        asked.take_part(page + num_own, end + num_own, rows)
    return asked.cut()


def _runs(is_wanted: Bool[Array, "p"]) -> Iterator[tuple[int, int]]:
    """Each page that is wanted, and the end of the run of such pages that it is in."""
    pages = np.flatnonzero(is_wanted)
    ends = np.append(np.flatnonzero(np.diff(pages) > 1), len(pages) - 1)  # the last of each run
    for page, last in zip(pages, pages[ends[np.searchsorted(ends, np.arange(len(pages)))]], strict=True):
        yield int(page), int(last) + 1


class _Asked:
    """One view at one pixel error, page by page."""

    def __init__(
        self,
        index: StoreIndex,
        page_of: Callable[[int, int], Page],
        view: View,
        options: SelectOptions,
        threads: int,
    ) -> None:
        self._index, self._page_of, self._view, self._options, self._threads = index, page_of, view, options, threads
        self._packed = kernel.pack(view, options)
        self._packed_unseen = kernel.pack(view, replace(options, view_test="none"))
        self._shadows = _shadows(index.table, view, options)
        self.is_open = _may_be_seen(index, view, options, self._packed, self._shadows)
        self._found: list[tuple[Array, int, Array]] = []
        self._portals: list[tuple[Array, Array]] = []
        self._visited = 0

    def take_file(self, number: int, end: int) -> None:
        """Select in a page of the only file; pages up to ``end`` are asked for next."""
        page = self._page_of(number, end)
        places = self._select(number, page, self._packed)
        self._keep(number, page, places, places + np.int32(page.begin))

    def take_crown(self, number: int, end: int) -> None:
        """Select in a page of the crown: inner nodes are drawn, leaves are open portals."""
        page, whole_rows = self._page_of(number, end), self._index.whole_rows
        assert whole_rows is not None and page.ids is not None
        places = self._select(number, page, self._packed_unseen)
        is_portal = page.tree.is_leaf[places]
        portals, places = places[is_portal], places[~is_portal]
        self._portals.append((page.ids[portals], whole_rows[page.begin + portals]))
        places = places[page.visible(places, self._view, self._options)]
        self._keep(number, page, places, whole_rows[page.begin + places])

    def holds_portals(self) -> Bool[Array, "o"]:
        """Whether each page of the crown holds portals of pages of parts that may be seen, and nothing drawn is above it."""
        index, holds = self._index, np.zeros(self._index.num_own, bool)
        if index.above is not None and index.above_start is not None:
            holds[index.above[np.repeat(self.is_open, np.diff(index.above_start))]] = True
        return holds & (self._shadows[: len(holds)] < index.table.end[: len(holds)])

    def portals(self) -> Int32[Array, "r"]:
        """The row in the whole of each root of a part whose portal is open, −1 for the others."""
        found = np.full(self._index.num_roots, -1, np.int32)
        for numbers, rows in self._portals:
            found[numbers] = rows
        return found

    def take_part(self, number: int, end: int, rows: Array) -> None:
        """Select in a page of a part, below open portals."""
        page, table = self._page_of(number, end), self._index.table
        places = self._select(number, page, self._packed)
        roots = np.flatnonzero(page.depth == 0)
        nth = np.searchsorted(roots, places, side="right")  # 0: of the subtree that the page begins within
        row_of_root = rows[table.first_root[number] + nth - 1]
        is_below = row_of_root >= 0
        places, nth, row_of_root = places[is_below], nth[is_below], row_of_root[is_below]
        path = table.ancestors[table.ancestor_start[number] : table.ancestor_start[number + 1]]
        before = table.rows[path[:1]] - page.begin if len(path) else np.zeros(1, np.int32)
        self._keep(number, page, places, row_of_root + places - np.concatenate([before, roots])[nth])

    def _select(self, number: int, page: Page, packed: kernel.PackedCut) -> Int32[Array, "v"]:
        places, visited = page.select(packed, int(self._shadows[number]), threads=self._threads)
        self._visited += visited
        return places

    def _keep(self, number: int, page: Page, places: Array, rows: Array) -> None:
        largest = self._options.max_radius
        if largest is not None:
            is_small = page.small(places, self._view, replace(self._options, pixel_error=largest))
            places, rows = places[is_small], rows[is_small]
        if len(places):
            self._found.append((rows, number, places))

    def cut(self) -> tuple[Cut, int]:
        """All rows that were kept, and how many were looked at."""
        none = np.zeros(0, np.int32)
        rows = np.concatenate([none, *(rows for rows, _, _ in self._found)])
        pages = np.concatenate([none, *(np.full(len(rows), number, np.int32) for rows, number, _ in self._found)])
        places = np.concatenate([none, *(places for _, _, places in self._found)])
        order = np.argsort(rows)
        columns = (column[order].astype(np.int32) for column in (rows, pages, places))
        return Cut(*columns), self._visited


def _shadows(table: PageTable, view: View, options: SelectOptions) -> Int64[Array, "p"]:
    """The row, in its file, up to which ancestors that stop shadow each page; 0 if none does."""
    rows = np.arange(len(table.rows), dtype=np.int32)
    stops = kernel.small(table.gaussians, table.tree, rows, view, options, threads=1)
    reach = np.where(stops, table.subtree_end, 0)[table.ancestors]
    reach = np.append(reach, 0)  # so that the last of the runs may be empty
    start = table.ancestor_start[:-1]
    longest = np.maximum.reduceat(reach, start) if len(start) else reach[:0]
    return np.asarray(np.where(np.diff(table.ancestor_start) > 0, longest, 0), np.int64)


def _may_be_seen(
    index: StoreIndex, view: View, options: SelectOptions, packed: kernel.PackedCut, shadows: Int64[Array, "p"]
) -> Bool[Array, "p"]:
    """Whether each page may have something in the image that is not below a node that is drawn."""
    table = index.table
    boxes = _Boxes(table.lower, table.upper, np.zeros((len(table), 1), np.float32), table.leaf_scales[:, None])
    may_be = ~_outside(boxes, view, options, packed) & (shadows < table.end)
    pages = np.flatnonzero(may_be)
    if len(pages):
        start = table.block_start
        counts = start[pages + 1] - start[pages]
        firsts = np.cumsum(counts) - counts
        nth = np.arange(counts.sum()) - np.repeat(firsts, counts)
        blocks = nth + np.repeat(start[pages], counts)
        columns = table.block_lower, table.block_upper, table.block_step_extents, table.block_step_scales
        boxes = _Boxes(*(column[blocks] for column in columns))
        end = np.repeat(table.begin[pages], counts) + (nth + 1) * BLOCK_ROWS
        is_needed = ~_outside(boxes, view, options, packed) & (end > np.repeat(shadows[pages], counts))
        may_be[pages] = np.logical_or.reduceat(is_needed, firsts)
    return may_be


class _Boxes(NamedTuple):
    """Boxes of runs of rows, with the columns of `BlockIndex`; of one step where no more is known."""

    lower: Float32[Array, "b 3"]
    upper: Float32[Array, "b 3"]
    step_extents: Float32[Array, "b s"]
    step_scales: Float32[Array, "b s"]


def _outside(boxes: _Boxes, view: View, options: SelectOptions, packed: kernel.PackedCut) -> Bool[Array, "b"]:
    """Whether the image has nothing of each box: the test of blocks in kernels/cpu/frame/select.cpp."""
    question, sides = packed
    outside = np.zeros(len(boxes.lower), bool)
    if not sides.is_culled:
        return outside
    lower, upper = boxes.lower.astype(np.float64), boxes.upper.astype(np.float64)
    centre, half = (lower + upper) / 2, (upper - lower) / 2
    scales = boxes.step_scales[:, -1].astype(np.float64)
    if question.rule.sphere:
        # An inner row that is drawn has an extent of at most τ_R (distance - extent) / f; 3σ is at most this, or in the steps.
        farthest = np.linalg.norm(np.abs(centre - view.camera.position) + half, axis=1)
        most = MARGIN * options.pixel_error * farthest / question.rule.focal_max
        step = (boxes.step_extents[:, 1:] <= most[:, None]).sum(axis=1)
        of_step = np.take_along_axis(boxes.step_scales, step[:, None], axis=1)[:, 0]
        scales = np.maximum(np.where(farthest < DISTANCE_MOST, of_step, scales), most / SIGMAS)
    for plane, reach in zip(sides.planes, sides.reaches, strict=False):
        nearest = centre @ plane[:3] + plane[3] - half @ np.abs(plane[:3])
        outside |= nearest > reach * scales
    return outside
