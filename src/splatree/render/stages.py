"""A frame stage by stage: project → bin → blend, with what each took.

The picture is that of standard 3D Gaussian Splatting (Kerbl 2023), and has the same bits for any number of threads and any order
of rows.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from splatree.kernels.contract import FrameStages
from splatree.scene.clusters import Culling
from splatree.scene.frame import Counters, Frame, Picture, RenderResult, Selection, Splats, TileBins
from splatree.scene.scene import Scene
from splatree.scene.view import View

__all__ = ["Clock", "draw_rows", "frame_of", "result_of"]


@dataclass(frozen=True)
class Clock:
    """Times of stages as they are run."""

    milliseconds: dict[str, float] = field(default_factory=dict)
    """Wall time by stage."""
    cpu_milliseconds: dict[str, float] = field(default_factory=dict)
    """Processor time by stage, all threads together."""

    def start(self, stage: str) -> Callable[[], None]:
        """Take the time of a stage from now until the function that is returned is called."""
        start, cpu = time.perf_counter(), time.process_time()

        def stop() -> None:
            self.milliseconds[stage] = 1e3 * (time.perf_counter() - start)
            self.cpu_milliseconds[stage] = 1e3 * (time.process_time() - cpu)

        return stop

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Take the time of what is run within."""
        stop = self.start(stage)
        yield
        stop()


def draw_rows(
    stages: FrameStages, scene: Scene, view: View, selection: Selection, clock: Clock, *, threads: int = 0
) -> tuple[Splats, TileBins, Picture]:
    """Draw the rows that were selected."""
    with clock.timed("project"):
        splats = stages.project(
            scene.gaussians, scene.ids, selection.rows, view, curves=scene.tree.curves, threads=threads
        )
    with clock.timed("bin"):
        bins = stages.bin(splats, view, threads=threads)
    with clock.timed("blend"):
        picture = stages.blend(splats, bins, view, threads=threads)
    return splats, bins, picture


def frame_of(
    view: View,
    culling: Culling | None,
    selection: Selection,
    drawn: tuple[Splats, TileBins, Picture],
    clock: Clock,
) -> Frame:
    """A frame of what its stages left."""
    splats, bins, picture = drawn
    result = result_of(picture, (len(selection), len(splats), bins.num_pairs), clock)
    return Frame(view, culling, selection, splats, bins, picture, result)


def result_of(picture: Picture, counts: tuple[int, int, int], clock: Clock) -> RenderResult:
    """A picture with its counters; ``counts`` are rows selected, splats visible and pairs."""
    assert picture.depth is not None  # results are of views that want it
    counters = Counters(*counts, picture.num_evaluated, picture.num_blended)
    return RenderResult(
        picture.image, picture.alpha, picture.depth, counters, clock.milliseconds, clock.cpu_milliseconds
    )
