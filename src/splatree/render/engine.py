"""One scene on one device, drawn view by view: what a session does, without its locks and its queue.

A frame is culled, selected and drawn. A device that holds the scene (kernels/contract.py: `HeldScene`) does all of it as one
piece of work if the rule is `cut` and no budget is to be met; otherwise rows are chosen first and then drawn there. All other
devices draw stage by stage. `Engine.choose` is the one place where rows come from.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeGuard, cast

import numpy as np

from splatree.kernels.contract import FrameStages, HeldScene
from splatree.kernels.devices import DeviceName, feature_of, stages_of
from splatree.kernels.reference.select import in_runs
from splatree.lod.blocks import with_blocks
from splatree.lod.quality import Gauge
from splatree.lod.select import Selector, cull_rule, cull_scene, for_levels, notes_on, smallest_radius
from splatree.lod.select import select as select_rows
from splatree.render.stages import Clock, draw_rows, frame_of, result_of
from splatree.render.updates import updated_scene
from splatree.scene.clusters import Culling
from splatree.scene.frame import Frame, RenderResult, Selection
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Int32

__all__ = ["Engine", "settled"]


class Engine:
    """A scene on a device; one call at a time."""

    def __init__(self, scene: Scene, device: DeviceName, columns: Mapping[str, Any], *, threads: int = 0) -> None:
        """``columns`` of the Gaussians lie on the device already; ``threads`` 0 means all there are."""
        self.scene = with_blocks(scene, threads=threads)
        self.stages: FrameStages = stages_of(device)
        reusing = feature_of(device, "reusing_stages")
        self.reusing: FrameStages = self.stages if reusing is None else reusing()
        self.held: HeldScene | None = None
        self.threads = threads
        self._met: tuple[SelectOptions, float] | None = None  # the last budget, and the τ_R that met it, px
        self._gauge = Gauge(lambda part, by_size: self.draw(part, by_size).image)
        hold = feature_of(device, "hold")
        if hold is not None:
            parts = (self.scene.gaussians, self.scene.ids, self.scene.tree, self.scene.blocks)
            self.held = cast(HeldScene, hold(*parts, columns))
            self.stages = cast(FrameStages, _HeldStages(self.held, self.stages))

    def settled(self, select: SelectOptions | Selector, view: View) -> SelectOptions | Selector:
        """The options of the selection with what follows from the scene and from how the view is drawn."""
        return settled(select, self.scene, view)

    def is_whole(self, select: SelectOptions | Selector) -> TypeGuard[SelectOptions]:
        """Whether the device selects and draws as one piece of work; it tests blocks, so exact culling adds nothing."""
        return (
            self.held is not None
            and self.scene.blocks is not None
            and isinstance(select, SelectOptions)
            and (select.rule, select.budget, select.quality, select.max_radius) == ("cut", None, None, None)
            and not select.occlusion
            and cull_rule(self.scene, select) in ("none", "exact")
        )

    def enqueue(self, view: View, select: SelectOptions) -> Callable[[], RenderResult]:
        """Let the device select and draw, and return what waits for the picture."""
        assert self.held is not None
        clock = Clock()
        stop = clock.start("frame")
        queued = self.held.enqueue(view, select)

        def downloaded() -> RenderResult:
            picture, counts = queued.download()
            stop()
            return result_of(picture, (counts["num_selected"], counts["num_visible"], counts["num_pairs"]), clock)

        return downloaded

    def draw(self, view: View, select: SelectOptions | Selector) -> RenderResult:
        """Draw a view and wait for it."""
        if self.is_whole(select):
            return self.enqueue(view, select)()
        return (self.trace(view, select) if self.held is not None else self._staged(view, select, self.reusing)).result

    def trace(self, view: View, select: SelectOptions | Selector) -> Frame:
        """Draw a view and keep what each stage computed."""
        if self.held is None:
            return self._staged(view, select, self.stages)
        clock = Clock()
        culling = None
        if self.is_whole(select):
            traced = self.held.trace(view, select)
            notes = notes_on(self.scene, select, select.pixel_error, view)
            selection = Selection(
                traced.rows, select.rule, select.resolved_profile, select.pixel_error, traced.num_visited, notes
            )
        else:
            culling, selection = self.choose(view, select, clock)
            traced = self.held.trace(view, SelectOptions(), rows=selection.rows)
        clock.milliseconds.update(traced.milliseconds)
        clock.cpu_milliseconds.update(traced.cpu_milliseconds)
        return frame_of(view, culling, selection, (traced.splats, traced.bins, traced.picture), clock)

    def _staged(self, view: View, select: SelectOptions | Selector, stages: FrameStages) -> Frame:
        """A frame, stage by stage."""
        clock = Clock()
        culling, selection = self.choose(view, select, clock)
        drawn = draw_rows(stages, self.scene, view, selection, clock, threads=self.threads)
        return frame_of(view, culling, selection, drawn, clock)

    def choose(
        self, view: View, select: SelectOptions | Selector, clock: Clock, *, last: float | None = None
    ) -> tuple[Culling | None, Selection]:
        """The rows to draw, and the clusters that were left out before; the search of a budget or of a quality begins at
        ``last``, px."""
        if not isinstance(select, SelectOptions):
            with clock.timed("select"):
                return None, select(view, threads=self.threads)
        if self.scene.blocks is None:  # an update kept the old index, which knows nothing of the new columns
            with clock.timed("select"):
                rows = np.arange(len(self.scene), dtype=np.int32)
                return None, Selection(rows, select.rule, select.resolved_profile, select.pixel_error, len(rows))
        if select.quality is not None:
            with clock.timed("measure"):
                point_px = smallest_radius(select.resolved_profile, view.dilation_px2)
                select = self._gauge.settled(select, view, point_px=point_px, last=last)
        culling = None
        if cull_rule(self.scene, select) != "none":
            with clock.timed("cull"):
                culling = cull_scene(self.scene, view, select, threads=self.threads)
        with clock.timed("select"):
            near = self._met[1] if self._met is not None and self._met[0] == select else None
            selection = select_rows(
                *(self.scene, view, select),
                culling=culling,
                last=last,
                near=near,
                stages=self.stages,
                threads=self.threads,
            )
        if select.budget is not None:
            self._met = select, selection.pixel_error
        return culling, selection

    def update(self, columns: Gaussians | Mapping[str, Array], *, keep_index: bool) -> None:
        """Replace columns of the Gaussians, here and on the device (render/updates.py)."""
        self.scene, names = updated_scene(self.scene, columns, keep_index=keep_index, threads=self.threads)
        self._gauge = Gauge(lambda part, by_size: self.draw(part, by_size).image)
        if self.held is not None:
            self.held.update(self.scene.gaussians, self.scene.blocks, names)


def settled(select: SelectOptions | Selector, scene: Scene, view: View) -> SelectOptions | Selector:
    """The options of a selection with what follows from the scene and from how a view of it is drawn."""
    if not isinstance(select, SelectOptions):
        return select
    select = for_levels(select, scene)
    if select.view_test == "footprint" and view.is_square:
        # Footprints are ellipses; the projection drops what squares do not show.
        select = replace(select, view_test="none")
    return select


class _HeldStages:
    """The stages of a back end whose selection reads the columns that a session holds on the device."""

    def __init__(self, held: HeldScene, stages: FrameStages) -> None:
        self._held = held
        self.project, self.bin, self.blend = stages.project, stages.bin, stages.blend

    def select(
        self,
        gaussians: Gaussians,
        tree: GaussianTree,
        blocks: BlockIndex | None,
        view: View,
        options: SelectOptions,
        *,
        runs: Int32[Array, "r 2"] | None = None,
        threads: int = 0,
    ) -> tuple[Int32[Array, "v"], int]:
        """The rows of the cut; the Gaussians, their tree and blocks are those that are held."""
        rows, num_visited = self._held.select(view, replace(options, budget=None, max_radius=None))
        return (rows if runs is None else rows[in_runs(rows, runs)]), num_visited
