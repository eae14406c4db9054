"""Draw a scene on a device: the order of a frame's work, without a wait for the device in it.

A frame is: copy the job (2 KB), clear the counters, select, project, order, bin, blend, copy the counters back. All of it is
enqueued at once; the kernels read how much there is to do from the counters. The second frame of a size is recorded as a CUDA
graph, later ones replay it.

Arrays have fixed sizes. If a view selects more rows or makes more pairs than they hold, the counters say how many: then
`Pending.finish` makes room and draws the view again. A picture that lacks something is never handed out.

Of the blend kernels and the orders of their tiles, those are taken that are fastest on this device at this size, measured once on
the first view.
"""

import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import get_args

import numpy as np

from splatree.constants import TILE_PX
from splatree.errors import InputError
from splatree.kernels.cuda import plan
from splatree.kernels.cuda.driver import Device, DeviceArray, Graph
from splatree.kernels.cuda.job import COUNTERS, pack_numbers
from splatree.kernels.cuda.plan import Blend, Launch, Sizes
from splatree.kernels.cuda.results import prepare_outputs, read_bins, read_outputs, read_splats, tile_work_of
from splatree.kernels.cuda.workspace import DeviceScene, Workspace
from splatree.scene.cameras import Camera
from splatree.scene.frame import Picture, Splats, TileBins, tiles_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Int32, UInt32

__all__ = ["DevicePicture", "Pending", "Renderer", "Traced"]

FIRST_ROWS, FIRST_PAIRS = 1 << 20, 1 << 22
"""Rows and pairs that a renderer has room for at first; it grows by half more than what a view needs."""
GROWTH = 1.5


class _Canvas:
    """Where one picture goes, with what the device reports of it."""

    def __init__(self, device: Device, width: int, height: int) -> None:
        self.arrays = {
            "image": device.empty((height, width, 3), np.float32, name="image"),
            "alpha": device.empty((height, width), np.float32, name="alpha"),
            "depth": device.empty((height, width), np.float32, name="depth"),
        }
        self.counters = device.pinned((len(COUNTERS) + 2,), np.uint64)
        num_tiles = -(-width // TILE_PX) * -(-height // TILE_PX)
        self.tile_work = device.pinned((num_tiles, 3), np.uint64)
        self.done = device.event()


class _Loan:
    """A canvas that is in use; when this object goes, it is free for the next picture, which the device draws after this one."""

    def __init__(self, canvas: _Canvas, free: list[_Canvas]) -> None:
        self.canvas = canvas
        weakref.finalize(self, free.append, canvas).atexit = False


class DevicePicture:
    """A picture in device memory, its own as long as any of its arrays is kept, here or in what they were shared with."""

    def __init__(self, loan: _Loan, counters: dict[str, int]) -> None:
        arrays = {name: array.kept_with(loan) for name, array in loan.canvas.arrays.items()}
        self.image: DeviceArray = arrays["image"]
        """Colour over the background, float32 (h w 3)."""
        self.alpha: DeviceArray = arrays["alpha"]
        """Share of light that the splats stop, float32 (h w)."""
        self.depth: DeviceArray = arrays["depth"]
        """Blended view depth over alpha, world units, float32 (h w)."""
        self.counters = counters
        """Rows selected and visited, splats visible, pairs."""
        self.tile_work: Array = loan.canvas.tile_work.values.copy()
        """What the blend did in each tile: entries consumed, evaluations, evaluations blended."""


@dataclass(frozen=True, eq=False)
class Traced:
    """A frame with all that lies between, on the host."""

    rows: Int32[Array, "v"]
    """Rows selected, ascending."""
    num_visited: int
    """Rows looked at."""
    splats: Splats
    """Those that touch the image."""
    bins: TileBins
    """Splats of each tile."""
    picture: Picture
    """The picture."""
    milliseconds: dict[str, float]
    """Time of each stage on the device."""
    cpu_milliseconds: dict[str, float]
    """Processor time of launching it."""


class Pending:
    """A view that was enqueued."""

    def __init__(self, renderer: "Renderer", loan: _Loan, sizes: Sizes, again: Callable[[], "Pending"]) -> None:
        self._renderer, self._loan, self._sizes, self._again = renderer, loan, sizes, again

    def finish(self) -> DevicePicture:
        """Wait for the picture; if the arrays were too small for it, make room and draw it again."""
        pending: Pending = self
        while True:
            canvas = pending._loan.canvas
            canvas.done.wait()
            counts = dict(zip(COUNTERS, canvas.counters.values.tolist(), strict=False))
            if not pending._renderer._grow(counts, pending._sizes):
                return DevicePicture(pending._loan, counts)
            pending = pending._again()

    def download(self) -> tuple[Picture, dict[str, int]]:
        """Wait for the picture; it and the counters of its frame on the host."""
        drawn = self.finish()
        work = tile_work_of(drawn.tile_work)
        return Picture(drawn.image.numpy(), drawn.alpha.numpy(), drawn.depth.numpy(), work), drawn.counters


class Renderer:
    """Draws views of one scene; holds its columns and a frame's arrays in device memory."""

    def __init__(
        self,
        device: Device,
        gaussians: Gaussians,
        tree: GaussianTree,
        blocks: BlockIndex,
        ids: UInt32[Array, "n"] | None = None,
        *,
        blend: Blend | None = None,
        rows: int = FIRST_ROWS,
        pairs: int = FIRST_PAIRS,
        columns: Mapping[str, DeviceArray] = MappingProxyType({}),
    ) -> None:
        """``blend`` names a kernel instead of measuring; ``rows`` and ``pairs`` are what there is room for at first.

        ``columns`` of the Gaussians are on the device already.
        """
        self.device = device
        self.scene = DeviceScene(device, gaussians, ids, tree, blocks, columns)
        self._work = Workspace(device, self.scene)
        self._rows, self._pairs = min(rows, max(len(gaussians), 1)), pairs
        self._named_blend = blend
        self._blend: dict[tuple[int, int, bool], Blend] = {}
        self._graphs: dict[tuple[Sizes, Blend], Graph | None] = {}
        self._free: dict[tuple[int, int], list[_Canvas]] = {}

    def enqueue(self, view: View, select: SelectOptions) -> Pending:
        """Draw a view without waiting for it."""
        camera, sizes = view.camera, self._fit(view)
        loan = self._canvas(camera)
        self._work.write_job(self._numbers(view, select), loan.canvas.arrays)
        self._launch_frame(sizes, (camera.width, camera.height, sizes.tapers))
        loan.canvas.counters.fetch(self._work.arrays["counters"])
        loan.canvas.tile_work.fetch(self._work.arrays["tile_work"])
        loan.canvas.done.record()
        return Pending(self, loan, sizes, lambda: self.enqueue(view, select))

    def draw(self, view: View, select: SelectOptions) -> DevicePicture:
        """Draw a view and wait for it."""
        return self.enqueue(view, select).finish()

    def select(self, view: View, select: SelectOptions) -> tuple[Int32[Array, "v"], int]:
        """Rows of the visible cut, ascending, and how many were looked at."""
        while True:
            sizes = self._fit(view)
            self._work.write_job(self._numbers(view, select))
            self._work.clear()
            self._work.run(plan.select(sizes))
            counts = self._work.counts()
            if not self._grow(counts, sizes):
                rows = self._work.arrays["rows"].numpy(counts["num_selected"])[:, 0]
                return np.ascontiguousarray(rows), counts["num_visited"]

    def enqueue_selection(self, view: View, select: SelectOptions) -> None:
        """Select the rows of a view without waiting for them, nor for whether there was room: to be measured."""
        sizes = self._fit(view)
        self._work.write_job(self._numbers(view, select))
        self._work.clear()
        self._work.run(plan.select(sizes))

    def trace(
        self,
        view: View,
        select: SelectOptions,
        *,
        rows: Int32[Array, "v"] | None = None,
    ) -> Traced:
        """Draw a view stage by stage, with times, and copy everything to the host, with the outputs that the view wants.

        ``rows``, ascending, are drawn instead of selecting.
        """
        camera = view.camera
        if rows is not None:
            self._rows = max(self._rows, len(rows))
        while True:
            sizes = self._fit(view)
            loan = self._canvas(camera)
            prepare_outputs(self._work, view, sizes.pairs)
            self._work.write_job(self._numbers(view, select), loan.canvas.arrays)
            blend = self._blend.get((camera.width, camera.height, sizes.tapers), self._named_blend or "blend_16")
            stages = _stages(sizes, blend) | {"blend": plan.blend(sizes, blend, view.wanted)}
            if rows is not None:
                del stages["select"]
            self.device.prepare([launch.kernel for stage in stages.values() for launch in stage])
            times = self._timed(stages, rows)
            counts = self._work.counts()
            if not self._grow(counts, sizes):
                image, alpha, depth = (loan.canvas.arrays[name].numpy() for name in ("image", "alpha", "depth"))
                picture = Picture(image, alpha, depth, **read_outputs(self._work, view, counts["num_pairs"]))
                drawn = np.ascontiguousarray(self._work.arrays["rows"].numpy(counts["num_selected"])[:, 0])
                splats, slots = read_splats(self._work, drawn)
                bins = read_bins(self._work, camera, slots, len(drawn))
                return Traced(drawn, counts["num_visited"], splats, bins, picture, *times)

    def update(self, gaussians: Gaussians, blocks: BlockIndex | None, names: tuple[str, ...]) -> None:
        """Take over the named columns of the Gaussians, which are as many as before, and the index of their blocks, if any."""
        self.scene.update(gaussians, blocks, names)

    @property
    def bytes_held(self) -> int:
        """Device memory of the scene and of a frame's arrays; pictures not counted."""
        return sum(array.nbytes for array in [*self.scene.arrays.values(), *self._work.arrays.values()])

    def _numbers(self, view: View, select: SelectOptions) -> bytes:
        if select.budget is not None:
            raise InputError("Renderer: found a budget, wanted none: choose pixel_error with splatree.select first")
        return pack_numbers(view, select, degree=self.scene.sh_degree)

    def _fit(self, view: View) -> Sizes:
        num_x, num_y = tiles_of(view.camera)
        sizes = Sizes(
            num_blocks=self.scene.num_blocks,
            rows=self._rows,
            pairs=self._pairs,
            num_tiles=num_x * num_y,
            has_ids=self.scene.has_ids,
            tapers=view.tapers,
            num_multiprocessors=self.device.num_multiprocessors,
        )
        if sizes != self._work.sizes and self._work.fit(sizes):
            self._graphs.clear()
        return sizes

    def _grow(self, counts: dict[str, int], sizes: Sizes) -> bool:
        """Whether a view needed more than there was room for; makes room for it."""
        rows, pairs = counts["num_selected"], counts["num_pairs"]
        if rows > sizes.rows:
            self._rows = max(self._rows, min(int(rows * GROWTH), self.scene.num_rows))
        if pairs > sizes.pairs:
            self._pairs = max(self._pairs, int(pairs * GROWTH))
        return rows > sizes.rows or pairs > sizes.pairs

    def _canvas(self, camera: Camera) -> _Loan:
        free = self._free.setdefault((camera.width, camera.height), [])
        return _Loan(free.pop() if free else _Canvas(self.device, camera.width, camera.height), free)

    def _launch_frame(self, sizes: Sizes, size: tuple[int, int, bool]) -> None:
        if size not in self._blend:
            self._blend[size] = self._choose_blend(sizes)
            return  # the picture is there
        blend = self._blend[size]
        key = (sizes, blend)
        graph = self._graphs.get(key)
        if graph is not None:
            graph.launch()
            return
        launches = [launch for stage in _stages(sizes, blend).values() for launch in stage]
        if key in self._graphs:
            with self.device.recorded() as graphs:
                self._work.clear()
                self._work.run(launches)
            self._graphs[key] = graphs[0]
            graphs[0].launch()
            return
        self._work.clear()
        self._work.run(launches)
        self._graphs[key] = None  # next time; all kernels are loaded now

    def _choose_blend(self, sizes: Sizes) -> Blend:
        """The fastest kernel, after the picture was drawn with it."""
        self._work.clear()
        stages = _stages(sizes, "blend_16")
        del stages["blend"]
        self._work.run([launch for stage in stages.values() for launch in stage])
        if self._named_blend:
            self._work.run(plan.blend(sizes, self._named_blend))
            return self._named_blend
        kernels: tuple[Blend, ...] = get_args(Blend)
        for kernel in kernels:
            self._work.run(plan.blend(sizes, kernel))  # the first run of a kernel loads it
        times: dict[Blend, float] = {}
        for kernel in kernels:
            before, after = self.device.event(), self.device.event()
            self._work.arrays["tile_work"].clear()
            before.record()
            self._work.run(plan.blend(sizes, kernel))
            after.record()
            after.wait()
            times[kernel] = after.milliseconds_since(before)
        return min(times, key=lambda kernel: times[kernel])

    def _timed(
        self, stages: dict[str, list[Launch]], rows: Int32[Array, "v"] | None
    ) -> tuple[dict[str, float], dict[str, float]]:
        events = [self.device.event() for _ in range(len(stages) + 1)]
        self._work.clear()
        if rows is not None:
            self._work.fill("rows", rows[:, None])
            self._work.set_counts(num_selected=len(rows))
        events[0].record()
        cpu = [time.process_time()]
        for launches, event in zip(stages.values(), events[1:], strict=True):
            self._work.run(launches)
            event.record()
            cpu.append(time.process_time())
        events[-1].wait()
        on_device = [after.milliseconds_since(before) for before, after in pairwise(events)]
        on_host = [1e3 * (after - before) for before, after in pairwise(cpu)]
        return dict(zip(stages, on_device, strict=True)), dict(zip(stages, on_host, strict=True))


def _stages(sizes: Sizes, blend: Blend) -> dict[str, list[Launch]]:
    """A frame's launches by stage; the order by depth belongs to the projection, as on the processor."""
    return {
        "select": plan.select(sizes),
        "project": plan.project(sizes) + plan.order(sizes),
        "bin": plan.bin_pairs(sizes),
        "blend": plan.blend(sizes, blend),
    }
