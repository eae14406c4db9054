"""Sessions: what draws. A session holds one scene on one device and draws as many views of it as are asked for.

::

    Camera ─► cull ─────► select ────► project ─► bin ─► blend ─► RenderResult
              clusters    LoD cut      splats     tiles  image

    with st.open_session(scene) as session:
        for camera in cameras:
            image = session.draw(camera).image

What a session makes once: the copies of the columns on a device, its arrays for a frame, the index of the blocks. What it makes
a frame: a `View`, in which nothing is left open, and from it the frame. `render` and `trace` open a session, draw and close it.

Back ends (kernels/contract.py) that hold scenes draw a frame as one piece of work, if the rule is `cut` and no budget is to be
met; otherwise rows are chosen first and then drawn. All others draw stage by stage. The session never asks which device it is.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Any, TypeGuard, cast
from weakref import WeakSet

import numpy as np

from splatree.errors import InputError, SplatreeError
from splatree.kernels.contract import FrameStages, HeldScene
from splatree.kernels.devices import DeviceName, feature_of, stages_of
from splatree.kernels.reference.select import in_runs
from splatree.lod.blocks import with_blocks
from splatree.lod.select import Selector, cull_rule, cull_scene, for_levels, notes_on
from splatree.lod.select import select as select_rows
from splatree.render.lens import pinhole_of, through_lens
from splatree.render.stages import Clock, draw_rows, frame_of, result_of
from splatree.render.tensors import TensorScene
from splatree.render.updates import updated_scene
from splatree.scene.cameras import Camera
from splatree.scene.clusters import Culling
from splatree.scene.frame import Frame, RenderResult, Selection
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View, Wanted, view_of
from splatree.shapes import Array, Int32

__all__ = ["Pending", "Session", "open_session"]

NOTHING = Wanted()
"""No output beside colour, alpha and depth."""


def open_session(
    scene: Scene | TensorScene,
    *,
    device: DeviceName | None = None,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    threads: int = 0,
) -> "Session":
    """Open a session, which draws many views of one scene.

    Args:
        scene: what is drawn; or what `scene_from_tensors` made, which a GPU draws from where it lies.
        device: where views are selected and drawn: `cpu`, `cuda`, or `reference`, the definitions in NumPy, which are slow;
            None: `cpu`, or the device that the tensors lie on.
        options: how the views are drawn, unless a call says otherwise.
        select: which nodes are drawn, unless a call says otherwise: options, or a baseline (lod/baselines.py).
        threads: threads of the processor; 0 means all there are.

    Returns:
        The session; use it in a ``with`` statement, or call `Session.close`.

    Raises:
        InputError: there is no such device, or the tensors lie on another one.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example::

        with st.open_session(scene, device="cpu") as session:
            images = [session.draw(camera).image for camera in cameras]
    """
    columns: Mapping[str, Any] = {}
    if isinstance(scene, TensorScene):
        if device not in (None, scene.device) and scene.columns:
            raise InputError(f"open_session: found tensors on device {scene.device!r}, wanted them on {device!r}")
        device, columns, scene = device or scene.device, scene.columns, scene.scene
    return Session(scene, device or "cpu", (options, select), threads=threads, columns=columns)


class Pending:
    """A view that a session was asked to draw."""

    def __init__(self, draw: Callable[[], RenderResult]) -> None:
        self._draw: Callable[[], RenderResult] | None = draw
        self._result: RenderResult | None = None
        self._error: SplatreeError | None = None
        self._lock = threading.Lock()

    def wait(self) -> None:
        """Return when the view is drawn, or cannot be."""
        with self._lock:
            if self._draw is None:
                return
            try:
                self._result = self._draw()
            except SplatreeError as error:
                self._error = error
            self._draw = None

    def result(self) -> RenderResult:
        """Wait for the picture; the same object at each call.

        Raises:
            SplatreeError: what `Session.draw` would have raised.
        """
        self.wait()
        if self._error is not None:
            raise self._error
        assert self._result is not None
        return self._result


class Session:
    """Draws views of one scene on one device; `open_session` makes it. Any thread may call; one call works at a time."""

    def __init__(
        self,
        scene: Scene,
        device: DeviceName,
        defaults: tuple[RenderOptions | None, SelectOptions | Selector | None],
        *,
        threads: int = 0,
        columns: Mapping[str, Any] | None = None,
    ) -> None:
        """``defaults`` are options of the drawing and the selection; ``columns`` lie on the device already."""
        self.device, self._threads = device, threads
        self._options, self._select = defaults
        self._stages: FrameStages = stages_of(device)
        self._scene = with_blocks(scene, threads=threads)
        self._held: HeldScene | None = None
        hold = feature_of(device, "hold")
        if hold is not None:
            parts = (self._scene.gaussians, self._scene.ids, self._scene.tree, self._scene.blocks)
            self._held = cast(HeldScene, hold(*parts, columns or {}))
            self._stages = cast(FrameStages, _HeldStages(self._held, self._stages))
        self._lock = threading.RLock()
        self._worker: ThreadPoolExecutor | None = None
        self._pending: WeakSet[Pending] = WeakSet()
        self._is_open = True

    @property
    def scene(self) -> Scene:
        """What is drawn, with the index of its blocks; without it after an update that kept the old one."""
        return self._scene

    @property
    def draws_whole_frames(self) -> bool:
        """Whether the device draws a frame as one piece of work; `trace` then takes longer than `draw`, which is the frame."""
        return self._held is not None

    @property
    def stages(self) -> FrameStages:
        """The stages of the back end, for programs that run some of them alone (kernels/contract.py)."""
        return self._stages

    def view(self, camera: Camera, options: RenderOptions | None = None, wanted: Wanted = NOTHING) -> View:
        """The view that a camera is drawn as; of a camera with a lens, that of the pinhole that stands for it."""
        return view_of(self._scene, pinhole_of(camera), options or self._options, wanted)

    def draw(
        self,
        camera: Camera,
        *,
        options: RenderOptions | None = None,
        select: SelectOptions | Selector | None = None,
    ) -> RenderResult:
        """Draw a view.

        Args:
            camera: the view.
            options: how it is drawn, instead of the options of the session.
            select: which nodes are drawn, instead of the session's choice.

        Returns:
            The picture with its counters and times.

        Raises:
            InputError: the session is closed, or a budget of nodes cannot be met.
            DeviceError: the device has failed or has too little memory.

        Example::

            coarse = session.draw(camera, select=st.SelectOptions(pixel_error=8)).image
        """
        with self._working():
            view, chosen = self._settled(camera, options, select, NOTHING)
            drawn = self._enqueued(view, chosen)() if self._is_whole(chosen) else self._traced(view, chosen).result
            return through_lens(drawn, view.camera, camera)

    def enqueue(
        self,
        camera: Camera,
        *,
        options: RenderOptions | None = None,
        select: SelectOptions | Selector | None = None,
    ) -> Pending:
        """Ask for a view without waiting for it: as `draw`, but `Pending.result` waits. Views are drawn in the order asked.

        Raises:
            InputError: the session is closed.

        Example::

            pending = [session.enqueue(camera) for camera in cameras]
            images = [view.result().image for view in pending]
        """
        with self._working():
            view, chosen = self._settled(camera, options, select, NOTHING)
            if self._is_whole(chosen):
                drawn = self._enqueued(view, chosen)
            else:
                if self._worker is None:
                    self._worker = ThreadPoolExecutor(1, "splatree-session")
                drawn = self._worker.submit(self._draw_later, view, chosen).result
            pending = Pending(lambda: through_lens(drawn(), view.camera, camera))
            self._pending.add(pending)
            return pending

    def trace(
        self,
        camera: Camera,
        wanted: Wanted = NOTHING,
        *,
        options: RenderOptions | None = None,
        select: SelectOptions | Selector | None = None,
    ) -> Frame:
        """Draw a view and keep what each stage computed.

        Args:
            camera: the view.
            wanted: outputs of the blend beside colour, alpha and depth.
            options: how it is drawn, instead of the options of the session.
            select: which nodes are drawn, instead of the session's choice.

        Returns:
            Selection, splats, tile lists, picture and times; on a device the times are the device's. Of a camera with a lens
            all of it is of the pinhole that stands for the camera, and `Frame.result` alone is the camera's.

        Raises:
            InputError: the session is closed, or a budget of nodes cannot be met.
            DeviceError: the device has failed or has too little memory.

        Example::

            last = session.trace(camera, st.Wanted(last_pair=True)).picture.last_pair
        """
        with self._working():
            frame = self._traced(*self._settled(camera, options, select, wanted))
            return replace(frame, result=through_lens(frame.result, frame.camera, camera))

    def select(
        self,
        camera: Camera,
        *,
        options: RenderOptions | None = None,
        select: SelectOptions | Selector | None = None,
    ) -> Selection:
        """The rows that `draw` would draw.

        Raises:
            InputError: the session is closed, or a budget of nodes cannot be met.

        Example::

            num_nodes = len(session.select(camera))
        """
        with self._working():
            return self._chosen(*self._settled(camera, options, select, NOTHING), Clock())[1]

    def draw_on_device(
        self,
        camera: Camera,
        *,
        options: RenderOptions | None = None,
        select: SelectOptions | None = None,
    ) -> Any:
        """Draw a view and leave the picture in the memory of the device; waits until it is drawn.

        Its ``image``, ``alpha`` and ``depth`` are taken by ``torch.from_dlpack`` and the like without a copy. They keep their
        memory; once nothing keeps them, it serves the next picture. If torch is in use, all work goes to its current stream.

        Raises:
            InputError: the device has no memory of its own, the options are not of the rule `cut` without a budget, or the
                camera has a lens.

        Example::

            image = torch.from_dlpack(session.draw_on_device(camera).image)
        """
        with self._working():
            view, chosen = self._settled(camera, options, select, NOTHING)
            if self._held is None:
                raise InputError(f"draw_on_device: device {self.device!r} has no memory of its own; use draw")
            if camera.lens is not None:
                raise InputError(f"draw_on_device: camera {camera.name!r}: found a lens, wanted a pinhole; use draw")
            if not self._is_whole(chosen):
                raise InputError("draw_on_device: found a budget, a baseline or another rule than 'cut'; use draw")
            return self._held.enqueue(view, chosen).finish()

    def update(self, columns: Gaussians | Mapping[str, Array], *, keep_index: bool = False) -> None:
        """Replace columns of the Gaussians; rows, tree and their order stay. Views asked for before show the old columns.

        Args:
            columns: all columns, or some of them by name, float32, of as many rows as the scene has.
            keep_index: do not make the index of the blocks anew, which costs 25 ns a row. From then on every row is handed to
                the projection, until an update without ``keep_index``; only for scenes without levels.

        Raises:
            InputError: the session is closed, a name is unknown, or the index of a tree with levels shall be kept.
            ShapeError: a column has another number of rows or another type.

        Example::

            session.update({"sh": brighter})
        """
        self._wait_for_pending()
        with self._working():
            scene, names = updated_scene(self._scene, columns, keep_index=keep_index, threads=self._threads)
            self._scene = scene
            if self._held is not None:
                self._held.update(scene.gaussians, scene.blocks, names)

    def close(self) -> None:
        """Give back what the session holds, after the views asked for were drawn; a closed session cannot draw."""
        with self._lock:
            self._is_open = False
        self._wait_for_pending()
        if self._worker is not None:
            self._worker.shutdown()
        self._held = None

    def __enter__(self) -> "Session":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextmanager
    def _working(self) -> Iterator[None]:
        """One call at a time, of a session that is open."""
        with self._lock:
            if not self._is_open:
                raise InputError("session: found it closed, wanted it open; open another with open_session")
            yield

    def _wait_for_pending(self) -> None:
        for pending in list(self._pending):
            pending.wait()

    def _settled(
        self,
        camera: Camera,
        options: RenderOptions | None,
        select: SelectOptions | Selector | None,
        wanted: Wanted,
    ) -> tuple[View, SelectOptions | Selector]:
        """The view, and the options of the selection with what follows from the scene and from how it is drawn."""
        view = self.view(camera, options, wanted)
        chosen = select or self._select or SelectOptions()
        if isinstance(chosen, SelectOptions):
            chosen = for_levels(chosen, self._scene)
            if chosen.view_test == "footprint" and view.is_square:
                # Footprints are ellipses; the projection drops what squares do not show.
                chosen = replace(chosen, view_test="none")
        return view, chosen

    def _is_whole(self, select: SelectOptions | Selector) -> TypeGuard[SelectOptions]:
        """Whether the device selects and draws as one piece of work; it tests blocks, so exact culling adds nothing."""
        return (
            self._held is not None
            and self._scene.blocks is not None
            and isinstance(select, SelectOptions)
            and (select.rule, select.budget, select.max_radius) == ("cut", None, None)
            and cull_rule(self._scene, select) in ("none", "exact")
        )

    def _enqueued(self, view: View, select: SelectOptions) -> Callable[[], RenderResult]:
        """Let the device draw, and return what waits for the picture."""
        assert self._held is not None
        clock = Clock()
        stop = clock.start("frame")
        queued = self._held.enqueue(view, select)

        def downloaded() -> RenderResult:
            with self._lock:
                picture, counts = queued.download()
            stop()
            return result_of(picture, (counts["num_selected"], counts["num_visible"], counts["num_pairs"]), clock)

        return downloaded

    def _draw_later(self, view: View, select: SelectOptions | Selector) -> RenderResult:
        with self._lock:
            return self._traced(view, select).result

    def _traced(self, view: View, select: SelectOptions | Selector) -> Frame:
        clock = Clock()
        if self._held is None:
            culling, selection = self._chosen(view, select, clock)
            drawn = draw_rows(self._stages, self._scene, view, selection, clock, threads=self._threads)
            return frame_of(view, culling, selection, drawn, clock)
        culling = None
        if self._is_whole(select):
            traced = self._held.trace(view, select)
            notes = notes_on(self._scene, select, select.pixel_error, view)
            selection = Selection(
                traced.rows, select.rule, select.resolved_profile, select.pixel_error, traced.num_visited, notes
            )
        else:
            culling, selection = self._chosen(view, select, clock)
            traced = self._held.trace(view, SelectOptions(), rows=selection.rows)
        clock.milliseconds.update(traced.milliseconds)
        clock.cpu_milliseconds.update(traced.cpu_milliseconds)
        return frame_of(view, culling, selection, (traced.splats, traced.bins, traced.picture), clock)

    def _chosen(self, view: View, select: SelectOptions | Selector, clock: Clock) -> tuple[Culling | None, Selection]:
        """The rows to draw, and the clusters that were left out before."""
        if not isinstance(select, SelectOptions):
            with clock.timed("select"):
                return None, select(view, threads=self._threads)
        if self._scene.blocks is None:  # kept by an update: what the index says is of other columns
            with clock.timed("select"):
                rows = np.arange(len(self._scene), dtype=np.int32)
                return None, Selection(rows, select.rule, select.resolved_profile, select.pixel_error, len(rows))
        culling = None
        if cull_rule(self._scene, select) != "none":
            with clock.timed("cull"):
                culling = cull_scene(self._scene, view, select, threads=self._threads)
        with clock.timed("select"):
            selection = select_rows(
                self._scene, view, select, culling=culling, stages=self._stages, threads=self._threads
            )
        return culling, selection


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
