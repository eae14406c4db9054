"""A store drawn view by view: what `Engine` is for a scene in memory.

Rows are selected page by page (outofcore/paging.py) and projected page by page, where they lie. From the splats on, a frame is
that of a scene in memory, with the same bits.
"""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from splatree.errors import InputError
from splatree.kernels.contract import HeldScene
from splatree.kernels.cpu.frame.project import gathered
from splatree.kernels.devices import DeviceName, stages_of
from splatree.lod.quality import Gauge
from splatree.lod.select import Selector, smallest_radius
from splatree.outofcore.paging import Cut
from splatree.outofcore.store import Store
from splatree.render.engine import settled
from splatree.render.stages import Clock, frame_of
from splatree.scene.clusters import Culling
from splatree.scene.frame import Frame, RenderResult, Selection, Splats
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["PagedEngine"]


class PagedEngine:
    """A store on a device; one call at a time."""

    held: HeldScene | None = None
    """No device holds it."""

    def __init__(self, store: Store, device: DeviceName, *, threads: int = 0) -> None:
        self.store, self.scene = store, store.scene
        self.stages = stages_of(device)
        self._threads = threads
        self._gauge = Gauge(self._drawn_part)

    def settled(self, select: SelectOptions | Selector, view: View) -> SelectOptions | Selector:
        """The options of the selection with what follows from the store and from how the view is drawn."""
        return settled(select, self.scene, view)

    def is_whole(self, select: SelectOptions | Selector) -> bool:
        """A store is drawn stage by stage."""
        return False

    def enqueue(self, view: View, select: SelectOptions | Selector) -> Callable[[], RenderResult]:
        """Draw when the result is asked for."""
        return lambda: self.draw(view, select)

    def draw(self, view: View, select: SelectOptions | Selector) -> RenderResult:
        """Draw a view."""
        return self.trace(view, select).result

    def trace(self, view: View, select: SelectOptions | Selector) -> Frame:
        """Draw a view and keep what each stage computed."""
        clock = Clock()
        with clock.timed("select"):
            selection, cut = self._cut(view, select)
        with clock.timed("project"):
            splats = self._splats(cut, view)
        with clock.timed("bin"):
            bins = self.stages.bin(splats, view, threads=self._threads)
        with clock.timed("blend"):
            picture = self.stages.blend(splats, bins, view, threads=self._threads)
        return frame_of(view, None, selection, (splats, bins, picture), clock)

    def choose(
        self, view: View, select: SelectOptions | Selector, clock: Clock, *, last: float | None = None
    ) -> tuple[Culling | None, Selection]:
        """The rows to draw; the search of a budget or of a quality begins at ``last``, px."""
        with clock.timed("select"):
            return None, self._cut(view, select, last=last)[0]

    def update(self, columns: Gaussians | Mapping[str, Array], *, keep_index: bool) -> None:
        """Refused: a store is read-only.

        Raises:
            InputError: always.
        """
        raise InputError("update: found a store, wanted a scene in memory; read it")

    def _cut(self, view: View, select: SelectOptions | Selector, *, last: float | None = None) -> tuple[Selection, Cut]:
        if not isinstance(select, SelectOptions):
            selection = select(view, threads=self._threads)
            return selection, self.store.find(selection.rows)
        if select.quality is not None:
            point_px = smallest_radius(select.resolved_profile, view.dilation_px2)
            select = self._gauge.settled(select, view, point_px=point_px, last=last)
        return self.store.cut(view, select, last=last, look_ahead=True, threads=self._threads)

    def _drawn_part(self, view: View, select: SelectOptions) -> Array:
        """The picture of a part of a view."""
        splats = self._splats(self.store.cut(view, select, threads=self._threads)[1], view)
        bins = self.stages.bin(splats, view, threads=self._threads)
        return self.stages.blend(splats, bins, view, threads=self._threads).image

    def _splats(self, cut: Cut, view: View) -> Splats:
        ids = np.empty(len(cut), np.uint32)

        def parts() -> Iterator[tuple[Array, Splats]]:
            # Backwards: the pages that were selected in last are there, and those that come first stay for the next view.
            for number, of_page in reversed(list(cut.by_page())):
                places = cut.places[of_page]
                page = self.store.page_to_draw(number, places)
                ids[of_page] = self.store.ids(cut, number, of_page)
                splats = self.stages.project(
                    page.gaussians, None, places, view, curves=page.tree.curves, threads=self._threads
                )
                yield _places_in(of_page, places, len(page)), splats

        return gathered(parts(), cut.rows, ids, threads=self._threads)


def _places_in(of_page: Array, places: Array, num_rows: int) -> Array:
    """Which row of the cut each row of a page is."""
    found = np.zeros(num_rows, np.int64)
    found[places] = of_page
    return found
