"""Sessions: what draws. A session holds one scene on one device and draws as many views of it as are asked for.

::

    Camera ─► cull ─────► select ────► project ─► bin ─► blend ─► RenderResult
              clusters    LoD cut      splats     tiles  image

    with st.open_session(scene) as session:
        for camera in cameras:
            image = session.draw(camera).image

What a session makes once: the copies of the columns on a device, its arrays for a frame, the index of the blocks. What it makes
a frame: a `View`, in which nothing is left open, and from it the frame. `render` and `trace` open a session, draw and close it.

How a view is drawn is in render/engine.py. A session adds that any thread may call, that views can be asked for ahead
(render/pending.py), and that cameras may have a lens. It never asks which device it is.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import TracebackType
from typing import Any

from splatree.errors import InputError
from splatree.kernels.contract import FrameStages
from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.outofcore.store import Store
from splatree.render.engine import Engine
from splatree.render.lens import pinhole_of, through_lens
from splatree.render.moving import Motion, Moving
from splatree.render.paged import PagedEngine
from splatree.render.pending import Pending, Turns
from splatree.render.stages import Clock
from splatree.render.tensors import TensorScene
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame, RenderResult, Selection
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import check_threads
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene, check_is_scene
from splatree.scene.view import View, Wanted, view_of
from splatree.shapes import Array

__all__ = ["NOTHING", "Session", "open_session"]

NOTHING = Wanted()
"""No output beside colour, alpha and depth."""


@checked
def open_session(
    scene: Scene | TensorScene | Store,
    *,
    device: DeviceName | None = None,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    threads: int = 0,
) -> "Session":
    """Open a session, which draws many views of one scene.

    Args:
        scene: what is drawn; or what `scene_from_tensors` made, which a GPU draws from where it lies; or a store, which is
            read page by page.
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

    Example:
        >>> with st.open_session(scene, device="cpu") as session:
        ...     images = [session.draw(camera).image for camera in cameras]
        >>> len(images) == len(cameras)
        True
    """
    check_threads(threads)
    columns: Mapping[str, Any] = {}
    if isinstance(scene, TensorScene):
        if device not in (None, scene.device) and scene.columns:
            raise InputError(f"open_session: found tensors on device {scene.device!r}, wanted them on {device!r}")
        device, columns, scene = device or scene.device, scene.columns, scene.scene
    if isinstance(scene, Store):
        return Session(PagedEngine(scene, device or "cpu", threads=threads), device or "cpu", (options, select))
    check_is_scene(scene, "open_session")
    engine = Engine(scene, device or "cpu", columns, threads=threads)
    return Session(engine, device or "cpu", (options, select))


class Session:
    """Draws views of one scene on one device. `open_session` makes it.

    Any thread may call; one call works at a time.

    Example:
        >>> with st.open_session(scene) as session:
        ...     coarse = session.draw(camera, select=st.SelectOptions(pixel_error=20))
        ...     fine = session.draw(camera, select=st.SelectOptions(pixel_error=0))
        >>> coarse.counters.num_selected < fine.counters.num_selected
        True
    """

    def __init__(
        self,
        engine: Engine | PagedEngine,
        device: DeviceName,
        defaults: tuple[RenderOptions | None, SelectOptions | Selector | None],
    ) -> None:
        """``defaults`` are options of the drawing and the selection."""
        self.device = device
        self._options, self._select = defaults
        self._engine = engine
        self._turns = Turns()

    @property
    def scene(self) -> Scene:
        """What is drawn, with the index of its blocks; without it after an update that kept the old one. Of a store, a scene
        without rows that says how the store is drawn."""
        return self._engine.scene

    @property
    def draws_whole_frames(self) -> bool:
        """Whether the device draws a frame as one piece of work; `trace` then takes longer than `draw`, which is the frame."""
        return self._engine.held is not None

    @property
    def has_motion(self) -> bool:
        """Whether `motion` draws here: a scene in memory, stage by stage."""
        return isinstance(self._engine, Engine) and self._engine.held is None

    @property
    def stages(self) -> FrameStages:
        """The stages of the back end, for programs that run some of them alone (kernels/contract.py)."""
        return self._engine.stages

    @checked
    def view(self, camera: Camera, options: RenderOptions | None = None, wanted: Wanted = NOTHING) -> View:
        """The view that a camera is drawn as; of a camera with a lens, that of the pinhole that stands for it."""
        return view_of(self._engine.scene, pinhole_of(camera), options or self._options, wanted)

    @checked
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

        Example:
            >>> coarse = session.draw(camera, select=st.SelectOptions(pixel_error=8)).image
        """
        with self._turns.working():
            view, chosen = self._settled(camera, options, select)
            return through_lens(self._engine.draw(view, chosen), view.camera, camera)

    @checked
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

        Example:
            >>> pending = [session.enqueue(camera) for camera in cameras]
            >>> images = [view.result().image for view in pending]
        """
        with self._turns.working():
            view, chosen = self._settled(camera, options, select)
            if self._engine.is_whole(chosen):
                drawn = self._turns.waiting_for(self._engine.enqueue(view, chosen))
            else:
                drawn = self._turns.begun(lambda: self._engine.draw(view, chosen))
            return self._turns.pending(lambda: through_lens(drawn(), view.camera, camera))

    @checked
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

        Example:
            >>> last = session.trace(camera, st.Wanted(last_pair=True)).picture.last_pair
        """
        with self._turns.working():
            frame = self._engine.trace(*self._settled(camera, options, select, wanted))
            return replace(frame, result=through_lens(frame.result, frame.camera, camera))

    @checked
    def select(
        self,
        camera: Camera,
        *,
        options: RenderOptions | None = None,
        select: SelectOptions | Selector | None = None,
        last: float | None = None,
    ) -> Selection:
        """The rows that `draw` would draw.

        Args:
            camera: the view.
            options: how it is drawn, instead of the options of the session.
            select: which nodes are drawn, instead of the session's choice.
            last: τ_R, px, of a view nearby, at which the search of a budget or of a quality begins, and which makes it less
                exact; None: the search of `draw`.

        Raises:
            InputError: the session is closed, or a budget of nodes cannot be met.

        Example:
            >>> num_nodes = len(session.select(camera))
        """
        with self._turns.working():
            return self._engine.choose(*self._settled(camera, options, select), Clock(), last=last)[1]

    @checked
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
            InputError: the device has no memory of its own, the options are not of the rule `cut` by a pixel error, or the
                camera has a lens.

        Example:
            >>> image = torch.from_dlpack(session.draw_on_device(camera).image)
        """
        with self._turns.working():
            view, chosen = self._settled(camera, options, select)
            if self._engine.held is None:
                raise InputError(f"draw_on_device: device {self.device!r} has no memory of its own; use draw")
            if camera.lens is not None:
                raise InputError(f"draw_on_device: camera {camera.name!r}: found a lens, wanted a pinhole; use draw")
            if not self._engine.is_whole(chosen):
                raise InputError(
                    "draw_on_device: found a budget, a quality, a baseline or another rule than 'cut'; use draw"
                )
            return self._engine.held.enqueue(view, chosen).finish()

    @checked
    def motion(self, moving: Moving | None = None) -> Motion:
        """What draws a camera that moves, faster and less exactly than `draw`: render/moving.py says what is given up.

        Args:
            moving: what is given up for which time; None: the defaults.

        Raises:
            InputError: the device draws whole frames and keeps nothing between them, or the session draws by a baseline.

        Example:
            >>> motion = session.motion(st.Moving(target_ms=50))
            >>> pictures = [motion.draw(camera).image for camera in cameras]
        """
        if isinstance(self._engine, PagedEngine):
            raise InputError("motion: found a store, wanted a scene in memory; read it")
        if self._engine.held is not None:
            raise InputError(f"motion: device {self.device!r} draws whole frames; draw a smaller camera with draw")
        if not (self._select is None or isinstance(self._select, SelectOptions)):
            raise InputError("motion: found a baseline, wanted options of the selection; open another session")
        return Motion(self._engine, moving or Moving(), (self._options, self._select), self._turns.working)

    def update(self, columns: Gaussians | Mapping[str, Array], *, keep_index: bool = False) -> None:
        """Replace columns of the Gaussians; rows, tree and their order stay. Views asked for before show the old columns.

        Args:
            columns: all columns, or some of them by name, float32, of as many rows as the scene has.
            keep_index: do not make the index of the blocks anew, which costs 25 ns a row. From then on every row is handed to
                the projection, until an update without ``keep_index``; only for scenes without levels.

        Raises:
            InputError: the session is closed, a name is unknown, or the index of a tree with levels shall be kept.
            ShapeError: a column has another number of rows or another type.

        Example:
            >>> session.update({"sh": brighter})
        """
        self._turns.wait()
        with self._turns.working():
            self._engine.update(columns, keep_index=keep_index)

    def close(self) -> None:
        """Give back what the session holds, after the views asked for were drawn; a closed session cannot draw."""
        self._turns.close()
        self._engine.held = None

    def __enter__(self) -> "Session":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _settled(
        self,
        camera: Camera,
        options: RenderOptions | None,
        select: SelectOptions | Selector | None,
        wanted: Wanted = NOTHING,
    ) -> tuple[View, SelectOptions | Selector]:
        """The view and the choice of nodes for one call."""
        view, chosen = self.view(camera, options, wanted), select or self._select or SelectOptions()
        if not isinstance(chosen, SelectOptions) and not callable(chosen):
            raise InputError(f"select: found {type(chosen).__name__}, wanted SelectOptions, or a baseline")
        return view, self._engine.settled(chosen, view)
