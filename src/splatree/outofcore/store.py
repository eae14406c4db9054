"""A store: a scene on disk, of which only the pages are read that a view asks for.

`open_store` (outofcore/opened.py) opens a folder of parts or one ``.splatree``. Pages are mapped, checked and indexed as they
come, and kept until there are too many; those that were used longest ago go first. Which pages a view asks for is decided in
outofcore/paging.py.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields, replace
from functools import partial
from types import TracebackType

import numpy as np

from splatree.errors import InputError
from splatree.io.check import checked_rows
from splatree.io.formats.splatree.rows import StoredScene
from splatree.io.pages.index import StoreIndex
from splatree.io.pages.page import Page, page_of
from splatree.io.pages.table import row_bytes_of
from splatree.lod.select import for_levels, notes_on, within_budget
from splatree.outofcore.locate import crown_rows, find_rows
from splatree.outofcore.paging import Cut, cut_at
from splatree.scene.cameras import Camera
from splatree.scene.frame import Selection
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.scene.view import View, view_of
from splatree.shapes import Array, Int32, UInt8, UInt32

__all__ = ["Store"]

INDEX_BYTES = 30
"""What a page takes for each of its rows beside the mapped columns: the index of its blocks, its tree."""


FETCHED_BYTES = 1 << 23
"""Pages of an object of a store that follow each other are fetched together, up to so many bytes."""

STILL_VIEWS = 4
"""Views without a page that came after which no page is looked for ahead. After none, a flight over a city waits for 11 pages in
place of 2 (benchmarks/flight.py); each view that looks ahead takes one selection more."""

SAMPLE = 60_000
"""Gaussians of a sample: as many as framing looks at."""


class Store:
    """A scene on disk that is selected and drawn page by page; `open_store` opens one.

    Any thread may call; pages are loaded one at a time.

    Example:
        >>> with st.open_store("city.splatree") as store:
        ...     rows = store.select(camera).rows
        >>> bool((rows == st.select(st.read("city.splatree"), camera).rows).all())
        True
    """

    def __init__(self, files: list[StoredScene], index: StoreIndex, max_bytes: int) -> None:
        self.index = index
        """The pages."""
        self.max_bytes = max_bytes
        """What the pages that are kept may take."""
        self.num_loaded = 0
        """Pages that were loaded when they were needed, some of them again."""
        self.num_ahead = 0
        """Pages that were loaded before they were needed."""
        self._files = files
        self._pages: OrderedDict[int, Page] = OrderedDict()
        self._bytes = 0
        self._lock = threading.RLock()
        self._ahead: tuple[ThreadPoolExecutor, Future[None]] | None = None
        self._last_view: View | None = None
        self._num_before = 0  # pages that had come when it was drawn
        self._num_still = 0  # views since pages came
        self._is_open = True

    @property
    def scene(self) -> Scene:
        """A scene without rows that says how the store is drawn: mode, τ, record of the levels, provenance."""
        head = self._files[0].head
        none = np.zeros(0, np.int32)
        tree = GaussianTree(none, none.astype(np.uint8), none.astype(np.float32), record=head.record)
        scene = Scene(Gaussians.empty(head.sh_degree), tree, mode=head.mode, threshold=head.threshold)
        return replace(scene, tile_rule=head.tile_rule, source=head.source)

    @property
    def follows(self) -> bool:
        """Whether merged nodes follow the pixel that they are drawn at (`GaussianTree.curves`)."""
        return self._files[0].head.has_curves

    def __len__(self) -> int:
        return self.index.num_rows

    @property
    def resident_bytes(self) -> int:
        """What has been read of the pages that are kept at present, with the index of their blocks."""
        return self._bytes

    def select(
        self,
        view: Camera | View,
        options: SelectOptions | None = None,
        *,
        last: float | None = None,
        threads: int = 0,
    ) -> Selection:
        """Choose the nodes to draw in a view: the rows that `select` chooses of the whole tree at the same pixel error.

        A budget is met to 2 % by reading few pages, while `select` meets it to a node: their pixel errors differ a little.

        Args:
            view: a camera, for drawing with the options that the scene itself has; or a view.
            options: pixel error or budget, profile and view test; None: the defaults.
            last: τ_R, px, of the view before, as in `select`.
            threads: threads to use; 0: all.

        Raises:
            InputError: the rule is not `cut`, a rule of culling, occlusion or a quality is named, or a budget cannot be met.
            FormatError: a page that is needed is damaged.

        Example:
            >>> with st.open_store("city.splatree") as store:
            ...     store.select(camera, st.SelectOptions(budget=100)).pixel_error > 0
            True
        """
        return self.cut(view, options, last=last, threads=threads)[0]

    def cut(
        self,
        view: Camera | View,
        options: SelectOptions | None = None,
        *,
        last: float | None = None,
        look_ahead: bool = False,
        threads: int = 0,
    ) -> tuple[Selection, Cut]:
        """As `select`, and the page that each row is in.

        With ``look_ahead``, views that follow each other are taken for those of a camera that moves: the pages of its next view
        are loaded beside.
        """
        found = self._cut(view, options, self.page, last=last, threads=threads)
        if look_ahead:
            self._look_ahead(view, options, len(np.unique(found[1].pages)))
        return found

    def _look_ahead(self, view: Camera | View, options: SelectOptions | None, num_pages: int) -> None:
        """Load the pages of the next view of a camera that moves on as it does, if pages came lately and most were there."""
        if isinstance(view, Camera):
            view = view_of(self.scene, view)
        last, self._last_view = self._last_view, view
        before, self._num_before = self._num_before, self.num_loaded + self.num_ahead
        num_came = self._num_before - before
        self._num_still = 0 if num_came else self._num_still + 1
        if last is None or self._num_still > STILL_VIEWS or num_came > num_pages / 2:
            return
        pose = view.camera.camera_from_world
        step = pose @ np.linalg.inv(last.camera.camera_from_world)
        self.prefetch(replace(view, camera=replace(view.camera, camera_from_world=step @ pose)), options)

    def _cut(
        self,
        view: Camera | View,
        options: SelectOptions | None,
        page_of: Callable[[int, int], Page],
        *,
        last: float | None = None,
        threads: int = 0,
    ) -> tuple[Selection, Cut]:
        scene = self.scene
        if isinstance(view, Camera):
            view = view_of(scene, view)
        options = for_levels(given(options, SelectOptions, "select"), scene)
        _check_options(options)

        def cut_of(pixel_error: float) -> tuple[Cut, int]:
            at = replace(options, pixel_error=pixel_error)
            return cut_at(self.index, page_of, view, at, threads=threads)

        cut, visited, pixel_error = within_budget(cut_of, view, options, options.pixel_error, last=last)
        notes = notes_on(scene, options, pixel_error, view)
        return Selection(cut.rows, "cut", options.resolved_profile, pixel_error, visited, notes), cut

    def page(self, number: int, end: int = 0, *, ahead: bool = False) -> Page:
        """A page, loaded if it is not there; of an object of a store, those up to ``end`` come with it.

        Args:
            number: of the page.
            end: one past the last of the pages that are asked for next.
            ahead: whether they are counted as loaded before they were needed.

        Raises:
            FormatError: it is damaged.
            InputError: the store is closed.
        """
        with self._lock:
            if not self._is_open:
                raise InputError("store: found it closed, wanted it open; open another with open_store")
            page = self._pages.get(number)
            if page is None:
                numbers = range(number, self._end_of_fetch(number, end))
                for each, loaded in zip(reversed(numbers), reversed(self._loaded(numbers)), strict=True):
                    self._pages[each] = page = loaded
                    self._bytes += self._bytes_of(page)
                self._give_up()
                self.num_loaded += len(numbers) * (not ahead)
                self.num_ahead += len(numbers) * ahead
            self._pages.move_to_end(number)
            assert page is not None
            return page

    def _end_of_fetch(self, number: int, end: int) -> int:
        """One past the last page that is loaded with a page, of an object of a store."""
        table, file = self.index.table, self.index.file_of(number)
        if not self._files[file].file.is_elsewhere:
            return number + 1
        most_rows = min(FETCHED_BYTES, self.max_bytes // 2) // row_bytes_of(self._files[file].head)
        last = number
        for each in range(number + 1, min(end, int(self.index.file_start[file + 1]))):
            if each in self._pages or table.end[each] - table.begin[number] > most_rows:
                break
            last = each
        return last + 1

    def _loaded(self, numbers: range) -> list[Page]:
        """Consecutive pages of one file, read at once."""
        table, stored = self.index.table, self._files[self.index.file_of(numbers[0])]
        rows = stored.rows(int(table.begin[numbers[0]]), int(table.end[numbers[-1]]), harmonics=False)
        return [
            page_of(
                rows.part(int(table.begin[number]), int(table.end[number])),
                str(stored.file.path),
                table.path(number),
                checksums=self.index.checksums_of(number),
            )
            for number in numbers
        ]

    def page_to_draw(self, number: int, places: Int32[Array, "w"]) -> Page:
        """A page of which harmonics and curves have been checked in some of its rows.

        Raises:
            FormatError: it is damaged.
        """
        with self._lock:
            page = self.page(number)
            before = self._bytes_of(page)
            page.check_drawn(places)
            self._bytes += self._bytes_of(page) - before
            self._give_up()
            return page

    def ids(self, cut: Cut, number: int, of_page: Array) -> UInt32[Array, "w"]:
        """Identities of those rows of a cut that are in a page: as in the whole tree."""
        rows, places = cut.rows[of_page], cut.places[of_page]
        page = self.page(number)
        own = rows.astype(np.uint32) if page.ids is None else page.ids[places]
        if not self.index.has_parts:
            return own
        merged = np.uint32(self.index.largest_id + 1) + rows.astype(np.uint32)
        return np.where(page.tree.is_leaf[places], own, merged)

    def find(self, rows: Int32[Array, "v"]) -> Cut:
        """The pages of rows of the whole tree, ascending.

        Raises:
            FormatError: a page that is needed for it is damaged.
        """
        return find_rows(self.index, self._files[0], self.page, rows)

    def depths(self, cut: Cut) -> UInt8[Array, "v"]:
        """The depth of each row in the whole tree."""
        found = np.empty(len(cut), np.int64)
        for number, of_page in cut.by_page():
            found[of_page] = self.page(number).depth[cut.places[of_page]]
        if self.index.has_parts:
            above = self._files[0].file.rows("tree.depth")[crown_rows(self.index, cut.rows)]
            found += np.where(cut.pages < self.index.num_own, 0, above)
        return np.minimum(found, 255).astype(np.uint8)

    def sample(self) -> Scene:
        """A flat scene of Gaussians that are evenly spread over the store, for programs that choose views.

        They are leaves. In a folder they are roots of its parts, merged Gaussians of a few leaves: these lie together.

        Example:
            >>> with st.open_store("city.splatree") as store:
            ...     framing = st.frame_scene(store.sample())
        """
        stored, scene = self._files[0], self.scene
        end = stored.file.rows("tree.subtree_end")
        leaves = np.flatnonzero(end == np.arange(1, len(end) + 1, dtype=np.int32))
        rows = leaves[:: -(-len(leaves) // SAMPLE) or 1]
        columns = {f.name: stored.file.rows(f"gaussians.{f.name}")[rows] for f in fields(Gaussians)}
        gaussians, _ = checked_rows(Gaussians(**columns), str(stored.file.path), repair=False)
        flat = Scene.flat(gaussians, mode=scene.mode, source=scene.source)
        stored.forget(0, len(stored))
        return replace(flat, threshold=scene.threshold, tile_rule=scene.tile_rule)

    def prefetch(self, view: Camera | View, options: SelectOptions | None = None) -> None:
        """Load the pages of a view in a thread of the store's own; returns at once. Nothing is done while it is busy.

        Example:
            >>> with st.open_store("city.splatree") as store:
            ...     store.prefetch(cameras[1])
        """
        with self._lock:
            if self._ahead is None:
                self._ahead = ThreadPoolExecutor(1, "splatree-store"), Future()
            elif not self._ahead[1].done():
                return
            self._ahead = self._ahead[0], self._ahead[0].submit(self._load_ahead, view, options)

    def close(self) -> None:
        """Give back the pages; a closed store cannot be read."""
        with self._lock:
            self._is_open = False
            ahead, self._ahead = self._ahead, None
        if ahead is not None:
            ahead[0].shutdown()
        self._pages.clear()
        self._bytes = 0

    def __enter__(self) -> "Store":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _load_ahead(self, view: Camera | View, options: SelectOptions | None) -> None:
        try:
            self._cut(view, options, partial(self.page, ahead=True), threads=1)
        except InputError:
            return  # who draws the view is told, if it is drawn

    def _bytes_of(self, page: Page) -> int:
        """What has been read of a page: all of an object of a store; of a file what drawing alone reads where it was checked."""
        all_bytes = len(page) * (row_bytes_of(self._files[0].head) + INDEX_BYTES)
        if self._files[0].file.is_elsewhere:
            return all_bytes
        return all_bytes - int(page.drawn_bytes * (1 - page.is_checked.mean()))

    def _give_up(self) -> None:
        """Give up the pages that were used longest ago while there are too many, but not the last one."""
        while len(self._pages) > 1 and self._bytes > self.max_bytes:
            number, page = self._pages.popitem(last=False)
            self._bytes -= self._bytes_of(page)
            self._files[self.index.file_of(number)].forget(page.begin, page.begin + len(page))


def _check_options(options: SelectOptions) -> None:
    if options.rule != "cut":
        raise InputError(
            f"rule: found {options.rule!r} for a store, wanted 'cut'; the others look at all rows: read the scene"
        )
    if options.cull not in (None, "none"):
        raise InputError(
            f"cull: found {options.cull!r} for a store, wanted none; pages are left out by their own boxes"
        )
    if options.occlusion:
        raise InputError(
            "occlusion: found it asked of a store, wanted a scene in memory, of which a first picture is drawn; leave it out, or "
            "read the scene whole"
        )
    if options.quality is not None:
        raise InputError(
            f"quality: found {options.quality:g} dB for a store, wanted a pixel error or a budget; a quality is measured by "
            "drawing: ask a session of the store, as open_session makes it"
        )
