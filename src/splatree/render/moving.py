"""Pictures for a camera that moves: less is drawn, and more of the last picture is used again, than in an exact frame.

What an exact frame makes anew and this one keeps:

- *The cut.* It is chosen for a picture that is larger by `Moving.guard` on each side. While the picture lies within the larger
  one and the eye has moved by at most `Moving.step` of the distance, no node is looked at. A camera that would leave it within
  `AHEAD` pictures, by the motion between the last two, gets a cut of its own picture: a third fewer nodes.
- *The budget.* The search begins at the τ_R of the last cut: 1 to 1.1 cuts on a path.
- *Columns.* From the fourth picture of a cut on, those of its nodes lie together, with 3 numbers of colour in place of 48.
- *Colours.* They are then those seen from where the cut was chosen: 10 % of the distance is an angle of 6°.

A pixel is finished once 1/255 of the light is left, not 10⁻⁴, and there is no depth. With a time to meet, the picture becomes
smaller until it is met. Cost: where the cut is chosen anew, a cut or two; once a cut, a projection of all of its nodes; else
what is drawn, at 56 bytes a node.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SH_C0
from splatree.errors import InputError
from splatree.render.engine import Engine
from splatree.render.stages import Clock
from splatree.scene.cameras import Camera
from splatree.scene.frame import Counters, Selection
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import check_literals
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import View, Wanted, view_of
from splatree.shapes import Array, Float32, UInt32

__all__ = ["Motion", "MovedFrame", "Moving"]

LEAST_LIGHT: Final = ALPHA_THRESHOLD
"""Light below which a pixel is finished: no step of 8 bits. 58 dB against an exact picture, for 14 % of the blending."""

NEAR_SHARE: Final = 0.05
"""The distance that a step of the eye is compared with is exceeded by all but this share of the nodes."""

SAMPLE: Final = 4096
"""Nodes of which it is taken."""

ZOOM_MAX: Final = 1.3
"""Ratio of focal lengths, either way, from which a cut is too fine or too coarse: nodes fall about as its square."""

SLOW, FAST = 1.2, 0.6
"""Shares of the time to meet from which pictures become smaller, and larger again …"""

SHRINK, GROW = 0.85, 1.15
"""… by these factors along each side."""

AHEAD: Final = 3
"""Pictures after its own that a cut of a larger picture has to serve: its nodes, half as many again, cost what three save."""

GATHER_AFTER: Final = 3
"""Pictures of a cut after which its columns are gathered: that costs what three more pictures save."""


@dataclass(frozen=True)
class Moving:
    """How pictures are drawn while the camera moves: never as exact as a picture by `Session.draw`.

    Example:
        >>> with st.open_session(scene) as session:
        ...     motion = session.motion(st.Moving(target_ms=60))
        ...     frames = [motion.draw(camera) for camera in cameras]
        >>> frames[0].image.shape[1] == frames[0].camera.width
        True
    """

    target_ms: float | None = None
    """Time that a picture shall take, ms on the clock: pictures become smaller, and get fewer nodes, until it is met. None:
    pictures are as large as the camera's."""
    least_scale: float = 0.25
    """Smallest side of such a picture over that of the camera's."""
    guard: float = 0.1
    """Share of the picture by which a cut reaches beyond each side. Until the camera has turned so far, the cut is kept."""
    step: float = 0.1
    """Share of the distance by which the eye may move until the cut and its colours are chosen anew; 0.1 are 6° at most."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.target_ms is not None and not self.target_ms > 0:
            raise InputError(f"target_ms: found {self.target_ms}, wanted more than 0 ms")
        if not 0 < self.least_scale <= 1:
            raise InputError(f"least_scale: found {self.least_scale}, wanted more than 0, at most 1")
        for name in ("guard", "step"):
            if not 0 <= getattr(self, name) <= 0.5:
                raise InputError(f"{name}: found {getattr(self, name)}, wanted 0 to 0.5")


@dataclass(frozen=True, eq=False)
class MovedFrame:
    """A picture of a camera that moves.

    Example:
        >>> with st.open_session(scene) as session:
        ...     motion = session.motion()
        ...     [motion.draw(camera).has_chosen for _ in range(3)]
        [True, False, False]
    """

    image: Float32[Array, "h w 3"]
    """Colour over the background, nominally 0 to 1, not clipped above."""
    alpha: Float32[Array, "h w"]
    """Share of light that the splats stop, 0 to 1."""
    camera: Camera
    """What was drawn: the camera asked for, with a smaller picture if time was short."""
    selection: Selection
    """The cut, with the nodes beyond the sides of the picture."""
    has_chosen: bool
    """Whether the cut was chosen for this picture; else it is that of an earlier one."""
    counters: Counters
    """How much work each stage did."""
    milliseconds: dict[str, float]
    """Wall time of each stage."""
    cpu_milliseconds: dict[str, float]
    """Processor time of each stage, all threads together."""


@dataclass(frozen=True, eq=False)
class _Cut:
    """The nodes of a cut, and for which picture it was chosen."""

    scene: Scene
    """What it was chosen from."""
    asked: tuple[SelectOptions, View]
    """How it was chosen."""
    view: View
    """The larger picture that it was chosen for."""
    distance: float
    """That nearly all nodes exceed, world units."""
    selection: Selection
    """The nodes."""

    @property
    def is_guarded(self) -> bool:
        """Whether it may serve pictures after its own."""
        return self.view.camera.width > self.asked[1].camera.width


@dataclass(frozen=True, eq=False)
class _Columns:
    """All that a picture needs of the nodes that are in a larger picture, as they are seen from one place."""

    gaussians: Gaussians
    """The nodes, of degree 0: the colours seen from there."""
    ids: UInt32[Array, "v"]
    """Their identities."""
    curves: Float32[Array, "v 4"] | None
    """How they follow the pixel that they are drawn at."""


class Motion:
    """Draws a camera that moves; `Session.motion` makes one for each camera. It keeps the last cut, and its columns.

    Example:
        >>> with st.open_session(scene, select=st.SelectOptions(budget=200)) as session:
        ...     motion = session.motion()
        ...     moving = [motion.draw(camera).image for camera in cameras]
        ...     still = session.draw(cameras[-1]).image
        >>> bool(st.psnr(moving[-1], still) > 20)
        True
    """

    def __init__(
        self,
        engine: Engine,
        moving: Moving,
        defaults: tuple[RenderOptions | None, SelectOptions | None],
        working: Callable[[], AbstractContextManager[None]],
    ) -> None:
        """``working`` holds the session for a call."""
        self._engine, self._moving, self._working = engine, moving, working
        self._options, self._select = defaults
        self._cut: _Cut | None = None
        self._columns: _Columns | None = None
        self._num_drawn = 0  # pictures of this cut
        self._scale = 1.0
        self._last: float | None = None  # τ_R of the last cut
        self._seen: Camera | None = None  # the last view

    def draw(
        self, camera: Camera, *, options: RenderOptions | None = None, select: SelectOptions | None = None
    ) -> MovedFrame:
        """Draw the next view of the camera.

        Args:
            camera: the view.
            options: how it is drawn, instead of the options of the session.
            select: which nodes are drawn, instead of the session's choice. A budget is of the nodes in the picture, and is met
                to a tenth.

        Raises:
            InputError: the session is closed, the camera has a lens, or a budget of nodes cannot be met.
        """
        if camera.lens is not None:
            raise InputError(f"motion: camera {camera.name!r}: found a lens, wanted a pinhole; use Session.draw")
        with self._working():
            smaller = camera.scaled(self._scale) if self._scale < 1 else camera
            view = view_of(self._engine.scene, smaller, options or self._options, Wanted(depth=False))
            clock = Clock()
            kept = self._cut
            cut = self._cut_of(view, select or self._select or SelectOptions(), clock)
            frame = self._drawn(cut, replace(view, least_light=LEAST_LIGHT), clock, cut is not kept)
            self._seen = camera
            if not (frame.has_chosen and cut.is_guarded):
                self._follow(sum(frame.milliseconds.values()))
            return frame

    def _cut_of(self, view: View, select: SelectOptions, clock: Clock) -> _Cut:
        """The last cut if it will do, else one that is chosen now."""
        engine, kept = self._engine, self._cut
        if (
            kept is not None
            and kept.scene is engine.scene
            and _are_alike(kept.asked, (select, view))
            and may_keep(kept.view.camera, view.camera, distance=kept.distance, step=self._moving.step)
        ):
            return kept
        guarded = replace(view, camera=guarded_by(view.camera, self._guard_of(view.camera)))
        wanted = select
        if select.budget is not None:
            area = (guarded.camera.width * guarded.camera.height) / (view.camera.width * view.camera.height)
            wanted = replace(select, budget=max(1, round(select.budget * self._scale * area)))
        _, chosen = engine.choose(guarded, engine.settled(wanted, guarded), clock, last=self._last)
        distance = near_distance(engine.scene, chosen.rows, view.camera.position)
        self._cut = _Cut(engine.scene, (select, view), guarded, distance, chosen)
        self._columns, self._num_drawn, self._last = None, 0, chosen.pixel_error
        return self._cut

    def _guard_of(self, camera: Camera) -> float:
        """By what share the picture of a new cut is larger: by none if the camera moves on too fast for that to pay."""
        guard, seen, cut = self._moving.guard, self._seen, self._cut
        if seen is None or cut is None:
            return guard
        motion = camera.camera_from_world @ np.linalg.inv(seen.camera_from_world)
        ahead = replace(camera, camera_from_world=np.linalg.matrix_power(motion, AHEAD) @ camera.camera_from_world)
        larger = guarded_by(camera, guard)
        return guard if may_keep(larger, ahead, distance=cut.distance, step=self._moving.step) else 0.0

    def _drawn(self, cut: _Cut, view: View, clock: Clock, has_chosen: bool) -> MovedFrame:
        stages, threads = self._engine.reusing, self._engine.threads
        if self._columns is None and self._num_drawn == GATHER_AFTER:
            with clock.timed("gather"):
                self._columns = _columns_of(self._engine, cut)
        self._num_drawn += 1
        kept = self._columns
        g, ids, curves, rows = cut.scene.gaussians, cut.scene.ids, cut.scene.tree.curves, cut.selection.rows
        if kept is not None:
            g, ids, curves, rows = kept.gaussians, kept.ids, kept.curves, np.arange(len(kept.ids), dtype=np.int32)
            view = replace(view, sh_degree=0)
        with clock.timed("project"):
            splats = stages.project(g, ids, rows, view, curves=curves, threads=threads)
        with clock.timed("bin"):
            bins = stages.bin(splats, view, threads=threads)
        with clock.timed("blend"):
            picture = stages.blend(splats, bins, view, threads=threads)
        counts = (len(rows), len(splats), bins.num_pairs, picture.num_evaluated, picture.num_blended)
        times = clock.milliseconds, clock.cpu_milliseconds
        return MovedFrame(
            picture.image, picture.alpha, view.camera, cut.selection, has_chosen, Counters(*counts), *times
        )

    def _follow(self, milliseconds: float) -> None:
        """Let the size of pictures follow the time that the last one took."""
        target = self._moving.target_ms
        if target is None:
            return
        factor = SHRINK if milliseconds > SLOW * target else GROW if milliseconds < FAST * target else 1.0
        self._scale = min(1.0, max(self._moving.least_scale, self._scale * factor))


def guarded_by(camera: Camera, guard: float) -> Camera:
    """The camera with a larger picture: by a share on each side."""
    if not guard:
        return camera
    x, y = round(guard * camera.width), round(guard * camera.height)
    K = camera.K.copy()
    K[0, 2] += x
    K[1, 2] += y
    return replace(camera, K=K, width=camera.width + 2 * x, height=camera.height + 2 * y)


def may_keep(kept: Camera, camera: Camera, *, distance: float, step: float) -> bool:
    """Whether a picture lies within the one that a cut was chosen for.

    The eye may have moved by ``step`` of the ``distance``. The rays through the corners have to pass through the larger picture,
    away from its sides by what a node at this distance has moved.
    """
    moved = float(np.linalg.norm(camera.position - kept.position))
    zoom = camera.K[0, 0] / kept.K[0, 0]
    if moved > step * distance or camera.near != kept.near or not 1 / ZOOM_MAX < zoom < ZOOM_MAX:
        return False
    corners = np.array([[x, y, 1.0] for x in (0, camera.width) for y in (0, camera.height)])
    rays = np.linalg.solve(camera.K, corners.T)
    x, y, z = kept.camera_from_world[:3, :3] @ camera.camera_from_world[:3, :3].T @ rays
    if (z <= 0).any():
        return False
    pixels = (kept.K @ (np.stack([x, y, z]) / z))[:2].T
    slack = (moved / distance if moved else 0.0) * kept.K[[0, 1], [0, 1]]
    return bool((pixels >= slack).all() and (pixels <= np.array([kept.width, kept.height]) - slack).all())


def _are_alike(one: tuple[SelectOptions, View], other: tuple[SelectOptions, View]) -> bool:
    """Whether all is asked in the same way but for the camera and the background."""
    return one[0] == other[0] and all(
        getattr(one[1], name) == getattr(other[1], name)
        for name in ("mode", "dilation_px2", "threshold", "tile_rule", "pixels", "sh_degree")
    )


def _columns_of(engine: Engine, cut: _Cut) -> _Columns:
    """The columns of the nodes of a cut that are in its larger picture, with the colours seen from there."""
    scene, view = cut.scene, cut.view
    curves, g = scene.tree.curves, scene.gaussians
    splats = engine.reusing.project(g, scene.ids, cut.selection.rows, view, curves=curves, threads=engine.threads)
    rows = splats.rows
    means, quats, scales, logits = (
        np.take(c, rows, axis=0) for c in (g.means, g.quats, g.log_scales, g.logit_opacities)
    )
    sh = (splats.colors - np.float32(0.5)) / np.float32(SH_C0)
    return _Columns(
        Gaussians(means, quats, scales, logits, sh[:, None]),
        rows.astype(np.uint32) if scene.ids is None else scene.ids[rows],
        None if curves is None else np.take(curves, rows, axis=0),
    )


def near_distance(scene: Scene, rows: Array, eye: Array) -> float:
    """The distance from the eye that all but a few of the rows exceed."""
    if len(rows) == 0:
        return np.inf
    sample = np.take(scene.gaussians.means, rows[:: len(rows) // SAMPLE + 1], axis=0)
    return float(np.quantile(np.linalg.norm(sample.astype(np.float64) - eye, axis=1), NEAR_SHARE))
