"""Frames a second, as FilterGS (Wang 2026, §4.1) and its successors report them, with everything included.

A frame is all of select → project → bin → blend, from the camera to the finished picture; nothing is hoisted out but what is made
once a scene. Stages of the paper's Table 2 are ours as follows:

==========  =======================================================================================
T_calcu     ``cull`` and ``select``: clusters, radii, the cut, the view test, the list of rows (t_f of Table 1)
T_synch     nothing: there is no second processor to wait for
T_prepr     ``project``: splats, colours and their order by depth (the paper sorts depths with the tiles)
T_sort      ``bin``: pairs of splats and tiles, tile by tile
T_alpha     ``blend``
==========  =======================================================================================

Cost: ``views`` + ``warm_up`` frames.
"""

import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.outofcore.store import Store
from splatree.progress import track
from splatree.render.paths import through
from splatree.render.session import open_session
from splatree.render.tensors import TensorScene
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, several
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene

__all__ = ["STAGES", "Timing", "check_frames", "peak_bytes", "time_frames"]

STAGES = {"T_calcu": "select", "T_prepr": "project", "T_sort": "bin", "T_alpha": "blend"}
"""Stages of a frame by the names of the paper's Table 2."""

FRAMES_MAX = 1_000_000
"""Frames timed at most; more is a mistake."""

MIN_VIEWS = 100
"""Frames timed at least: with fewer a 95th percentile is one frame."""


@dataclass(frozen=True)
class Timing:
    """How long frames along a path took.

    Example:
        >>> timing = st.time_frames(scene, [camera], views=4, warm_up=1)
        >>> timing.num_frames, timing.fps > 0
        (4, True)
    """

    num_frames: int
    """Number of frames timed."""
    num_warm_up: int
    """Number of frames drawn before them, which are not counted."""
    fps: float
    """Frames over the sum of their times."""
    fps_p95: float
    """One over the 95th percentile of a frame's time: 95 of 100 frames are at least as fast."""
    ms: dict[str, float]
    """Mean wall time of each stage. The time of culling is part of ``select``."""
    cpu_ms: dict[str, float]
    """Mean processor time of each stage, all threads together. Other work on the machine disturbs it least."""
    num_selected: float
    """Mean number of nodes chosen."""
    num_pairs: float
    """Mean N_P."""

    @property
    def filter_ms(self) -> float:
        """t_f: mean wall time of culling and selection."""
        return self.ms["select"]

    @property
    def frame_ms(self) -> float:
        """Mean wall time of a frame."""
        return 1e3 / self.fps

    @property
    def frame_cpu_ms(self) -> float:
        """Mean processor time of a frame."""
        return sum(self.cpu_ms.values())


def peak_bytes() -> int | None:
    """Largest resident memory of this process so far, reading included; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows has no such module
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def check_frames(frames: int) -> None:
    """Raise if there is nothing to time.

    Raises:
        InputError: fewer than one frame, or more than anyone waits for.
    """
    if not 1 <= frames <= FRAMES_MAX:
        raise InputError(f"frames: found {frames}, wanted 1 to {FRAMES_MAX:,}")


@checked
def time_frames(
    scene: Scene | TensorScene | Store,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    views: int = MIN_VIEWS,
    warm_up: int = 20,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Timing:
    """Time frames of a scene.

    Args:
        scene: any scene, or a store.
        cameras: views; frames are these views if they are at least ``views``, else a path through them.
        options: how they are drawn; None: as the scene says.
        select: which nodes are drawn: options, or a baseline.
        views: number of frames to time.
        warm_up: number of frames to draw before, which are not counted.
        device: where: `cpu`, `cuda` or `reference`; None: `cpu`.
        threads: threads of the processor; 0: all.

    Returns:
        Frames a second, and the mean time of each stage.

    Raises:
        InputError: there is no camera, or no frame is asked for.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example:
        >>> sorted(st.time_frames(scene, cameras, views=3, warm_up=0).ms)
        ['bin', 'blend', 'project', 'select']
    """
    if not (1 <= views <= FRAMES_MAX and 0 <= warm_up <= FRAMES_MAX):
        raise InputError(
            f"time_frames: found {views} views and {warm_up} to warm up, wanted at least 1 and 0, at most {FRAMES_MAX:,}"
        )
    cameras = several(cameras)
    path = cameras if len(cameras) >= views else list(through(cameras, views))
    seconds, counters, stages, cpu_stages = [], [], [], []
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        for i in range(warm_up):
            session.draw(path[i % len(path)])
        for camera in track(path, "time frames"):
            start = time.perf_counter()
            result = session.draw(camera)
            seconds.append(time.perf_counter() - start)
            if session.draws_whole_frames:  # a trace has the stages, but copies everything to the host
                result = session.trace(camera).result
            counters.append((result.counters.num_selected, result.counters.num_pairs))
            stages.append(_by_stage(result.milliseconds))
            cpu_stages.append(_by_stage(result.cpu_milliseconds))
    num_selected, num_pairs = np.mean(counters, axis=0)
    return Timing(
        num_frames=len(path),
        num_warm_up=warm_up,
        fps=len(path) / float(np.sum(seconds)),
        fps_p95=1 / float(np.quantile(seconds, 0.95)),
        ms={stage: float(np.mean([ms[stage] for ms in stages])) for stage in STAGES.values()},
        cpu_ms={stage: float(np.mean([ms[stage] for ms in cpu_stages])) for stage in STAGES.values()},
        num_selected=float(num_selected),
        num_pairs=float(num_pairs),
    )


def _by_stage(milliseconds: Mapping[str, float]) -> dict[str, float]:
    """Times of `STAGES`: what culling takes is part of the selection."""
    return {**milliseconds, "select": milliseconds["select"] + milliseconds.get("cull", 0.0)}
