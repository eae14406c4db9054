"""Wall time of a frame on a machine where as much other work runs as it has processors, against its fair share.

Twice as many threads want to run as there are processors: ours, one for each processor, and as many processes that only count.
What a counting process gets of a processor is what a thread of ours should get too, whatever else runs on the machine:

    share      = CPU-seconds of a counting process / seconds that it ran
    fair share = CPU-seconds of the frame without the counting processes / (threads × share)

The goal is a wall time of at most 1.5 times the fair share. A ratio near 1 says that a frame loses no time beyond what others
take: no thread waits actively, which would cost processor time, and none waits for a thread that has lost its processor longer
than the end of a stage demands. Other programs on the machine take part in both measurements.

``python benchmarks/busy.py``
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import splatree as st
from harness import save, table
from render import LEAVES, cloud
from splatree.kernels.cpu import _core

FRAMES = 100
FRAMES_ALONE = 20
"""Frames drawn before the counting processes start."""
SIZES = ((400_000, 640, 360), (2_000_000, 1280, 720))
"""Gaussians, width and height: frames of about 45 and 340 CPU-milliseconds."""


def main() -> None:
    rows = []
    for num, width, height in SIZES:
        scene = st.Scene.flat(cloud(num, reach=1.0, scale=0.046, seed=1))
        camera = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=width, height=height)
        rows.append(busy_row(lambda scene=scene, camera=camera: st.render(scene, camera, select=LEAVES), f"{num:,}"))
    print(table(rows))
    save("busy", rows, about="Frames beside as many busy processes as there are processors.")


def busy_row(frame: Callable[[], object], gaussians: str) -> dict[str, Any]:
    """The frame, drawn many times beside the counting processes."""
    processors = _core.hardware_threads()
    frame()
    cpu_alone = time.process_time()
    for _ in range(FRAMES_ALONE):
        frame()
    alone = (time.process_time() - cpu_alone) / FRAMES_ALONE
    started = time.perf_counter()
    children = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processors)]
    costs = []
    try:
        for _ in range(FRAMES):
            wall, cpu = time.perf_counter(), time.process_time()
            frame()
            costs.append((time.perf_counter() - wall, time.process_time() - cpu))
    finally:
        ran = time.perf_counter() - started
        counted = sum(end(child) for child in children)
    share = counted / len(children) / ran
    wall, cpu = np.array(costs).T
    fair = alone / (processors * share)
    return {
        "Gaussians": gaussians,
        "alone, CPU ms": 1e3 * alone,
        "CPU ms": 1e3 * float(np.mean(cpu)),
        "share of a processor": share,
        "fair share, ms": 1e3 * fair,
        "wall, ms": 1e3 * float(np.mean(wall)),
        "worst wall, ms": 1e3 * float(np.max(wall)),
        "wall / fair share": float(np.mean(wall)) / fair,
    }


def end(child: subprocess.Popen[bytes]) -> float:
    """End a process; the CPU-seconds that it has used."""
    child.kill()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
