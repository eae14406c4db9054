"""One page and its worker.

The page sends views faster than they can be answered. For each kind of answer only the newest view is kept, in a slot and not in
a queue, and a thread of the client's own answers: points first, then cuts, then pictures. A first cut comes in steps of 18,000,
80,000 and 300,000 nodes, so that there is a picture after 0.65 MB; a newer view ends the steps of an older one. Over a slow line
there are more steps, of what the line carries in two seconds (pace.py). What the page holds of a view is kept, and the rest of it
begins with few nodes (steps.py). New nodes come first, and what has changed of others after them.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from splatree.errors import InputError, SplatreeError
from splatree.render.moving import Motion, guarded_by
from splatree.render.quality import Carried
from splatree.scene.cameras import Camera
from splatree.scene.frame import Selection
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.shapes import Array
from splatree.view.exhibit import Exhibit
from splatree.view.messages import Ack, Request, Want, pack_message, parse
from splatree.view.pace import Pace
from splatree.view.pictures import encode, layer_of, pixels_of
from splatree.view.slots import Slots
from splatree.view.steps import advanced, mixed

__all__ = ["Client"]

LADDER: Final = (18_000, 80_000, 300_000)
"""Nodes of the first cuts: 0.65 MB, 2.9 MB, 10.8 MB."""

FIRST_TAU_PX: Final = 32.0
"""Where the search of the first budget begins: a cut of few nodes, whatever the scene."""

NODE_BYTES: Final = 36
"""A node that is added, with the number of its slot."""

PNG_BYTES: Final = 2
"""Bytes of a PNG a pixel, about."""

LONG_STEP: Final = 1.5
"""New nodes of a view are sent together if the line needs at most so many steps' time for them, 3 s."""

LONGEST_STEP: Final = 4.0
MOSTLY: Final = 0.25
"""And 8 s if at most so large a share of the view's nodes are new: coarse nodes that come first take the place of others that the
page holds, which would have to come again."""

ALONE: Final = 0.25
"""New nodes for which the line needs more of a step's time, 0.5 s, come without the colours and shapes of nodes that the page
holds. These follow, and wait no longer than one message, so that they are sent while the camera moves on."""

SOON: Final = 8.0
"""A view for whose new nodes the line needs at most so many steps' time, 16 s, becomes coarse and then fine, nothing between."""

LONG: Final[tuple[Want, ...]] = ("cut", "frame")
"""What a page acknowledges; it is sent once there is room."""

PATIENCE_S: Final = 30.0
"""Time after which a page that takes nothing in is given up."""

BOXES_MAX: Final = 2_000
"""Boxes sent at most: 48 kB; more would hide the picture."""

POINT_PX: Final = 9
"""Side of the picture that is drawn to find the point behind a pixel."""

ORDER: Final[tuple[Want, ...]] = ("point", "cut", "frame", "boxes")
"""Whose turn it is first."""


class Client:
    """A connected page."""

    def __init__(self, exhibit: Exhibit, send: Callable[[bytes], None], capacity: int) -> None:
        self._exhibit, self._send, self._capacity = exhibit, send, capacity
        self._turn = threading.Condition()
        self._wanted: dict[Want, Request] = {}
        self._news: list[bytes] = []
        self._new_exhibit: Exhibit | None = exhibit
        self._pace = Pace()
        self._is_open = True
        self._slots = Slots(exhibit.shown, exhibit.centre, capacity)
        self._last = FIRST_TAU_PX  # τ_R of the last cut
        self._last_whole = FIRST_TAU_PX  # of the last cut of a whole view
        self._last_of_frames = FIRST_TAU_PX
        self._motion: Motion | None = None
        self._quality = Carried(exhibit.session)
        self._reached = 0  # nodes that the last step was allowed
        self._stepping: Request | None = None  # the view that comes in steps
        self._whole: Selection | None = None  # its cut, where parts of it are held
        self._target: Selection | None = None  # the cut that its steps lead to next
        self._unfinished: tuple[Request, Selection] | None = None
        self._held: Selection | None = None  # the cut that the page holds
        self._has_put_off = False  # whether the last cut came without what has changed of held nodes
        self.camera: Camera | None = None
        """The newest view of the page."""
        self.seen_s = time.monotonic()
        """When it last said something."""

    def receive(self, text: str) -> None:
        """Take a text of the page.

        Raises:
            InputError: it is not what a page sends.
        """
        said = parse(text, self._exhibit.centre)
        with self._turn:
            self.seen_s = time.monotonic()
            if isinstance(said, Ack):
                self._pace.acknowledge(said.count, self.seen_s)
            else:
                self._wanted[said.want] = said
                self.camera = said.camera
            self._turn.notify_all()

    def show(self, exhibit: Exhibit) -> None:
        """Show another scene from now on."""
        with self._turn:
            self._new_exhibit = exhibit
            self._turn.notify_all()

    def look(self, camera: Camera) -> None:
        """Let the page take a camera."""
        pose = np.linalg.inv(camera.camera_from_world)
        pose[:3, 3] -= self._exhibit.centre
        fov = 2 * np.degrees(np.arctan(0.5 * camera.height / camera.K[1, 1]))
        with self._turn:
            self._news.append(pack_message({"kind": "look", "c2w": pose[:3].ravel().tolist(), "fov": float(fov)}))
            self._turn.notify_all()

    def close(self) -> None:
        """End the worker after what it is doing."""
        with self._turn:
            self._is_open = False
            self._turn.notify_all()

    def run(self) -> None:
        """Answer until the page is gone; ends by itself if the page takes nothing in for 30 s."""
        while True:
            with self._turn:
                want = self._next()
                if not self._is_open:
                    return
                news, self._news = self._news, []
                new, self._new_exhibit = self._new_exhibit, None
                request = self._wanted.pop(want) if want and not new else None
            if new is not None:
                self._begin(new)
            for message in news:
                self._send(message)
            if request is not None:
                try:
                    self._answer(request)
                except SplatreeError as error:
                    self._send(pack_message({"kind": "error", "seq": request.seq, "text": str(error)}))

    def _next(self) -> Want | None:
        """Wait for what there is to do; None: the page is told something, or is gone. A view is taken when it can be answered at
        once, so it is the newest.

        Raises:
            TimeoutError: there is no room for an answer within half a minute.
        """
        deadline = None
        while self._is_open and not (self._news or self._new_exhibit):
            now = time.monotonic()
            room_s = self._pace.wait_s(now)
            want = next((want for want in ORDER if want in self._wanted and (want not in LONG or room_s == 0)), None)
            if want is not None:
                return want
            if self._wanted:
                deadline = now + PATIENCE_S if deadline is None else deadline
                if now >= deadline:
                    raise TimeoutError(f"the page has taken nothing in for {PATIENCE_S:g} s")
                self._turn.wait(min(deadline - now, room_s))
            else:
                self._turn.wait()
        return None

    def _begin(self, exhibit: Exhibit) -> None:
        if exhibit is not self._exhibit:  # another scene in the place of one that was shown: no steps, no flicker
            self._reached = self._capacity
        self._exhibit, self._motion, self._quality = exhibit, None, Carried(exhibit.session)
        self._slots = Slots(exhibit.shown, exhibit.centre, self._capacity)
        self._unfinished = self._held = self._whole = self._target = None
        self._send(pack_message({"kind": "scene", "capacity": self._capacity, **exhibit.facts}))

    def _answer(self, request: Request) -> None:
        if request.want == "cut":
            self._cut(request)
        elif request.want == "frame":
            self._frame(request)
        elif request.want == "point":
            self._point(request)
        else:
            self._boxes(request)

    def _cut(self, request: Request) -> None:
        """One cut, or a step towards it: then the request is put back, unless a newer one has come.

        A request that is put back for the rest of its colours has its cut already.
        """
        asked = min(request.select.budget or self._capacity, self._capacity)
        start = time.process_time()
        unfinished, self._unfinished = self._unfinished, None
        if unfinished is not None and unfinished[0] is request:
            chosen, is_step = unfinished[1], False
        else:
            chosen, is_step = self._chosen(request, asked)
        selected = time.process_time()
        view = self._exhibit.session.view(request.camera)
        puts_off = not is_step and not self._has_put_off and self._is_long(chosen)
        has_colors = not (is_step or puts_off)
        change = self._slots.move(
            chosen.rows, request.camera.position, view, has_colors=has_colors, has_shapes=not puts_off
        )
        packed = time.process_time()
        self._held = chosen
        if is_step:
            self._stepping = request
        else:
            self._has_put_off = puts_off and change.is_behind
            self._reached, self._last_whole = self._capacity, chosen.pixel_error
            self._unfinished = (request, chosen) if change.is_behind else None
        is_last = not (is_step or change.is_behind)
        depths = np.bincount(self._exhibit.shown.depths(chosen.rows), minlength=1)
        header = {
            "kind": "cut",
            "seq": request.seq,
            "rows": len(chosen),
            "drop": len(change.drop),
            "runs": len(change.runs),
            "add": len(change.add),
            "shape": len(change.shaped),
            "tint": len(change.tint),
            "last": is_last,
            "visited": chosen.num_visited,
            "tau": finite(chosen.pixel_error),
            "select_ms": 1e3 * (selected - start),
            "pack_ms": 1e3 * (packed - selected),
            "levels": depths.tolist(),
        }
        self._deliver(pack_message(header, change.payload))
        if not is_last:
            with self._turn:
                self._wanted.setdefault("cut", request)

    def _is_long(self, chosen: Selection) -> bool:
        """Whether the line needs long for the new nodes of a cut."""
        carried = ALONE * self._pace.step_bytes / NODE_BYTES
        return bool(np.isfinite(carried)) and self._slots.num_new(chosen.rows) > carried

    def _chosen(self, request: Request, asked: int) -> tuple[Selection, bool]:
        """The rows of a view that the page may be sent next, and whether more of them follow."""
        select = self._quality.settled(request.camera, request.select)
        camera = guarded_by(request.camera, request.guard)
        carried = self._pace.step_bytes / NODE_BYTES
        # With occlusion a finer cut may be coarser in places, so there are no cuts between.
        if self._held is not None and np.isfinite(carried) and not select.occlusion:
            if self._stepping is not request:
                return self._begun(camera, select, asked, carried)
            return self._gone_on(request, camera, select, asked, carried)
        self._whole = self._target = None
        chosen = self._within(camera, select, min(self._next_rung(), asked), asked)
        is_step = self._reached < asked and len(chosen) > 0.5 * self._reached
        self._last = _next_guess(chosen, min(self._next_rung(), asked)) if is_step else chosen.pixel_error
        return chosen, is_step

    def _begun(self, camera: Camera, select: SelectOptions, asked: int, carried: float) -> tuple[Selection, bool]:
        """Another view over a line of which the pace is known: all of it, or what the page holds of it and the rest coarse."""
        whole = self._exhibit.cut(camera, replace(select, budget=asked), self._last_whole)
        self._last_whole = whole.pixel_error
        num_new = self._slots.num_new(whole.rows)
        steps = LONGEST_STEP if num_new <= MOSTLY * len(whole) else LONG_STEP
        if num_new <= min(steps * carried, self._next_rung()):
            return whole, False
        self._whole, self._target = whole, None
        few = carried * len(whole) / num_new
        chosen = self._within(camera, select, int(min(max(few, LADDER[0] / 4), LADDER[0], asked)), asked)
        if num_new <= SOON * carried:
            self._reached = LADDER[-1]  # no steps between
        return replace(chosen, rows=mixed(chosen.rows, whole.rows, self._slots.holds(whole.rows))), True

    def _gone_on(
        self, request: Request, camera: Camera, select: SelectOptions, asked: int, carried: float
    ) -> tuple[Selection, bool]:
        """The next step of a view: what is in the middle of the picture becomes finer first."""
        assert self._held is not None
        rung = min(self._next_rung(), asked)
        if self._target is None:
            self._target = self._next_target(camera, select, rung, asked)
        target, held = self._target, self._held.rows
        order = np.argsort(_off_axis(request.camera, self._exhibit.shown.means(held)))
        rows = advanced(held, target.rows, self._slots.holds(target.rows), order.astype(np.int32), carried)
        if not np.array_equal(rows, target.rows):
            return replace(target, rows=rows), True
        self._reached, self._target = rung, None
        self._last = _next_guess(target, min(self._next_rung(), asked))
        return target, rung < asked and len(target) > 0.5 * rung

    def _next_target(self, camera: Camera, select: SelectOptions, rung: int, asked: int) -> Selection:
        """The cut of the next rung of a view, finer where the page holds its whole cut."""
        if self._whole is not None and rung == asked:
            return self._whole
        target = self._exhibit.cut(camera, replace(select, budget=rung), self._last)
        if self._whole is None:
            return target
        return replace(target, rows=mixed(target.rows, self._whole.rows, self._slots.holds(self._whole.rows)))

    def _within(self, camera: Camera, select: SelectOptions, budget: int, asked: int) -> Selection:
        """The cut of a view within a step's budget, or within that of the first step that holds the scene's roots."""
        self._reached = budget
        try:
            return self._exhibit.cut(camera, replace(select, budget=budget), self._last)
        except InputError:
            if budget == asked:
                raise
            return self._within(camera, select, min(self._next_rung(), asked), asked)

    def _next_rung(self) -> int:
        return next((rung for rung in LADDER if rung > self._reached), self._capacity)

    def _frame(self, request: Request) -> None:
        start = time.perf_counter()
        is_plain = request.layer == "color" and request.box is None
        if request.is_moving and is_plain and self._exhibit.session.has_motion:
            return self._moving_frame(request, start)
        if request.is_held and self._held is None:
            return  # another scene has come meanwhile: the page asks again
        held = self._held if request.is_held else None
        # A budget is searched from the last picture's τ_R.
        is_limited = request.select.budget is not None and request.select.budget < self._capacity
        last = self._last_of_frames if is_limited else None
        result, chosen = self._exhibit.draw(
            request.camera, held or request.select, request.background, box=request.box, last=last
        )
        if is_limited and held is None:
            self._last_of_frames = chosen.pixel_error
        pixels = layer_of(result, request.layer)
        self._deliver_picture(request, pixels, chosen, result.counters.num_pairs, start)

    def _moving_frame(self, request: Request, start: float) -> None:
        """A picture while the camera moves: of an earlier cut, where that will do (render/moving.py)."""
        if self._motion is None:
            self._motion = self._exhibit.session.motion()
        options = RenderOptions(background=request.background)
        select = replace(request.select, occlusion=False)  # a first picture of each view would take as long as this one
        frame = self._motion.draw(request.camera, options=options, select=select)
        self._last_of_frames = frame.selection.pixel_error
        self._deliver_picture(request, pixels_of(frame.image), frame.selection, frame.counters.num_pairs, start)

    def _deliver_picture(
        self, request: Request, pixels: Array, chosen: Selection, num_pairs: int, start: float
    ) -> None:
        drawn = time.perf_counter()
        packing = request.packing
        if packing == "png" and PNG_BYTES * pixels.size / 3 > self._pace.step_bytes:
            packing = "jpeg"  # nearly exact in a fifth of the bytes, and views that follow wait less
        picture = encode(pixels, packing, request.quality)
        header = {
            "kind": "frame",
            "seq": request.seq,
            "width": request.camera.width,
            "height": request.camera.height,
            "type": f"image/{packing}",
            "rows": len(chosen),
            "visited": chosen.num_visited,
            "tau": finite(chosen.pixel_error),
            "pairs": num_pairs,
            "draw_ms": 1e3 * (drawn - start),
            "encode_ms": 1e3 * (time.perf_counter() - drawn),
        }
        self._deliver(pack_message(header, picture))

    def _point(self, request: Request) -> None:
        """Where the ray through a pixel ends, by the depth of a picture of a few pixels around it."""
        K = request.camera.K.copy()
        K[0, 2] += POINT_PX / 2 - request.at[0]
        K[1, 2] += POINT_PX / 2 - request.at[1]
        camera = replace(request.camera, K=K, width=POINT_PX, height=POINT_PX)
        select = replace(request.select, quality=None, occlusion=False)  # of these few pixels they say nothing
        result, _ = self._exhibit.draw(camera, select, (0.0, 0.0, 0.0), box=request.box)
        covered = result.alpha > 0.3
        point = None
        if covered.any():
            depth = float(np.median(result.depth[covered]))
            x, y = request.at[0] - request.camera.K[0, 2], request.at[1] - request.camera.K[1, 2]
            ray = np.array([x / K[0, 0], y / K[1, 1], 1.0]) * depth
            W, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
            point = (W.T @ (ray - t) - self._exhibit.centre).tolist()
        self._send(pack_message({"kind": "point", "seq": request.seq, "point": point}))

    def _boxes(self, request: Request) -> None:
        boxes = self._exhibit.shown.boxes(request.boxes, self._slots.rows, BOXES_MAX)
        boxes = (boxes - self._exhibit.centre).astype("<f4")
        header = {"kind": "boxes", "seq": request.seq, "of": request.boxes, "count": len(boxes)}
        self._send(pack_message(header, boxes.tobytes()))

    def _deliver(self, message: bytes) -> None:
        """Send what the page acknowledges."""
        with self._turn:
            if not self._is_open:
                return
            self._pace.send(len(message), time.monotonic())
        self._send(message)


def finite(value: float) -> float | None:
    """JSON has no infinity."""
    return float(value) if np.isfinite(value) else None


def _off_axis(camera: Camera, means: Array) -> Array:
    """The cosine of the angle between the middle of a view and each point, turned round: least in the middle."""
    away = means - camera.position.astype(np.float32)
    return np.asarray(
        -(away @ camera.camera_from_world[2, :3].astype(np.float32)) / np.linalg.norm(away, axis=1).clip(1e-12)
    )


def _next_guess(chosen: Selection, budget: int) -> float:
    """τ_R of a budget from that of another: nodes fall about as 1/τ_R²."""
    return chosen.pixel_error * float(np.sqrt(len(chosen) / budget)) if np.isfinite(chosen.pixel_error) else np.inf
