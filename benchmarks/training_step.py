"""A step of training on a device, stage by stage; a part of gpu.py."""

import statistics
import time
from typing import Any

import numpy as np

import splatree as st
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.stages import Stages
from splatree.kernels.devices import stages_of
from splatree.train.densify import Rows, Sightings
from splatree.train.schedule import rates
from splatree.train.step import Drawing, learn
from splatree.train.targets import Target

__all__ = ["train_row"]


def train_row(device: Device, scene: st.Scene, size: tuple[int, int], repeat: int) -> dict[str, Any]:
    """A step that learns a scene's own picture: wall milliseconds of each stage with its copies, beside the processor's."""
    camera = st.orbit(scene, st.PathOptions(views=1, width=size[0], height=size[1]))[0]
    photo = np.rint(255 * np.clip(st.render(scene, camera).image, 0, 1)).astype(np.uint8)
    target, found = Target(camera, photo, None), {}
    for name, stages in (("ours", Stages(device)), ("processor", stages_of("cpu"))):
        timed, cpu = Timed(stages), []
        rows = Rows.beginning(scene.gaussians.take(np.arange(len(scene))))
        for _ in range(repeat + 1):  # the first compiles, or makes pages
            busy = time.process_time()
            now = rates(0.5, 1.0, rows.moments, scene.gaussians.sh.shape[1])
            learn(rows, Sightings.none(len(scene)), target, np.eye(3, 4), now, 1.0, Drawing(timed, scene.mode, 3, 0))
            cpu.append(1e3 * (time.process_time() - busy))
        stages_ms = {stage: statistics.median(took[1:]) for stage, took in timed.took.items()}
        found[name] = {"stages": stages_ms, "wall": sum(stages_ms.values()), "CPU": statistics.median(cpu[1:])}
    ours, processor = found["ours"], found["processor"]
    return {
        "what": "train",
        "scene": f"{len(scene):,} Gaussians",
        "view": f"{camera.width} × {camera.height}",
        **{f"{stage} ms": took for stage, took in ours["stages"].items()},
        "step ms": ours["wall"],
        "CPU ms": ours["CPU"],
        "processor wall ms": processor["wall"],
        "processor CPU ms": processor["CPU"],
        "processor wall / ours": processor["wall"] / ours["wall"],
    }


class Timed:
    """Stages that write down how long they take, ms."""

    def __init__(self, stages: Any) -> None:
        self._stages = stages
        self.took: dict[str, list[float]] = {}

    def __getattr__(self, name: str) -> Any:
        stage = getattr(self._stages, name)

        def timed(*arguments: Any, **options: Any) -> Any:
            start = time.perf_counter()
            left = stage(*arguments, **options)
            self.took.setdefault(name, []).append(1e3 * (time.perf_counter() - start))
            return left

        return timed
