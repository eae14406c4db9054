"""One page and its worker.

The page sends views faster than they can be answered. For each kind of answer only the newest view is kept, in a slot and not in
a queue, and a thread of the client's own answers: points first, then cuts, then pictures. A first cut comes in steps of 18,000,
80,000 and 300,000 nodes, so that there is a picture after 0.65 MB; a newer view ends the steps of an older one. Over a slow line
there are more steps, of what the line carries in two seconds (pace.py), and a view that is new for the most part begins again.
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

__all__ = ["Client"]

LADDER: Final = (18_000, 80_000, 300_000)
"""Nodes of the first cuts: 0.65 MB, 2.9 MB, 10.8 MB."""

FIRST_TAU_PX: Final = 32.0
"""Where the search of the first budget begins: a cut of few nodes, whatever the scene."""

NODE_BYTES: Final = 36
"""A node that is added, with the number of its slot."""

PNG_BYTES: Final = 2
"""Bytes of a PNG a pixel, about."""

LONG_STEPS: Final = 4
"""A view is begun again with few nodes if the line needs so many steps for its new ones: 8 s. Fewer are sent as they are: a cut
of few nodes shares none with the one that the page holds."""

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
        self._last_of_frames = FIRST_TAU_PX
        self._motion: Motion | None = None
        self._quality = Carried(exhibit.session)
        self._reached = 0  # nodes that the last step was allowed
        self._stepping: Request | None = None  # the view that comes in steps
        self._unfinished: tuple[Request, Selection] | None = None
        self._held: Selection | None = None  # the cut that the page holds
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
            want = next(
                (want for want in ORDER if want in self._wanted and (want not in LONG or self._pace.has_room)), None
            )
            if want is not None:
                return want
            if self._wanted:
                now = time.monotonic()
                deadline = now + PATIENCE_S if deadline is None else deadline
                if now >= deadline:
                    raise TimeoutError(f"the page has taken nothing in for {PATIENCE_S:g} s")
                self._turn.wait(deadline - now)
            else:
                self._turn.wait()
        return None

    def _begin(self, exhibit: Exhibit) -> None:
        if exhibit is not self._exhibit:  # another scene in the place of one that was shown: no steps, no flicker
            self._reached = self._capacity
        self._exhibit, self._motion, self._quality = exhibit, None, Carried(exhibit.session)
        self._slots = Slots(exhibit.shown, exhibit.centre, self._capacity)
        self._unfinished = self._held = None
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
        change = self._slots.move(chosen.rows, request.camera.position, self._exhibit.session.view(request.camera))
        packed = time.process_time()
        self._held, self._last = chosen, chosen.pixel_error
        if is_step:
            self._stepping = request
            self._last = _next_guess(chosen, min(self._after_step(), asked))
        else:
            self._reached = self._capacity
            self._unfinished = (request, chosen) if change.is_behind else None
        is_last = not (is_step or change.is_behind)
        depths = np.bincount(self._exhibit.shown.depths(chosen.rows), minlength=1)
        header = {
            "kind": "cut",
            "seq": request.seq,
            "rows": len(chosen),
            "drop": len(change.drop),
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

    def _chosen(self, request: Request, asked: int) -> tuple[Selection, bool]:
        """The rows of a view that the page may be sent next, and whether more of them follow."""
        select = self._quality.settled(request.camera, request.select)
        camera = guarded_by(request.camera, request.guard)
        chosen = self._within(camera, select, min(self._after_step(), asked), asked)
        # Over a slow line, a view that is new for the most part begins with fewer nodes. A step of one and the same view goes on.
        carried = self._pace.step_bytes / NODE_BYTES
        most = max(LADDER[0], LONG_STEPS * carried)
        if len(chosen) > most and self._stepping is not request and self._slots.num_new(chosen.rows) > most:
            chosen = self._within(camera, select, int(max(LADDER[0], carried)), asked)
        return chosen, self._reached < asked and len(chosen) > 0.5 * self._reached

    def _within(self, camera: Camera, select: SelectOptions, budget: int, asked: int) -> Selection:
        """The cut of a view within a step's budget, or within that of the first step that holds the scene's roots."""
        self._reached = budget
        try:
            return self._exhibit.cut(camera, replace(select, budget=budget), self._last)
        except InputError:
            if budget == asked:
                raise
            return self._within(camera, select, min(self._after_step(), asked), asked)

    def _after_step(self) -> int:
        """Nodes of the next step: more than of the last by what the line carries; half of what comes replaces others."""
        rung = next((rung for rung in LADDER if rung > self._reached), self._capacity)
        if self._reached == 0:
            return rung
        return int(min(rung, self._reached + max(LADDER[0] / 4, 0.7 * self._pace.step_bytes / NODE_BYTES)))

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


def _next_guess(chosen: Selection, budget: int) -> float:
    """τ_R of a budget from that of another: nodes fall about as 1/τ_R²."""
    return chosen.pixel_error * float(np.sqrt(len(chosen) / budget)) if np.isfinite(chosen.pixel_error) else np.inf
