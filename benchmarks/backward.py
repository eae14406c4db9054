"""Cost of a step of training, stage by stage: forward, loss, backward, optimiser; one thread, processor milliseconds.

``python benchmarks/backward.py [scene] [--isa v3]``; without a scene, one chunk of the shared city, with harmonics of degree
1. The least of seven steps counts. ``ns/px-splat`` are of the evaluations of a splat's opacity at a pixel that the blend
counts, ``ns/px`` of the loss, ``µs/row`` of what is done for each visible Gaussian (backward of the projection, and the
step). ``whole step ms`` is a step as `train` makes it. What of it lies outside compiled kernels runs in one thread, so a share s
bounds the speed-up of two threads to 1 / (1 + s) of the ideal: ``two threads at most``."""

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

import splatree as st
from harness import DATA, save, table
from splatree.kernels.cpu import _core
from splatree.kernels.devices import training_stages_of
from splatree.scene.gradients import Moments, PictureGradients
from splatree.train.densify import Rows, Sightings
from splatree.train.schedule import rates
from splatree.train.step import Drawing, learn
from splatree.train.targets import Target

CHUNK = DATA / "trained" / "semarang_city" / "5_1"
SIZES = ((400, 300), (800, 600))
REPEAT = 7


class Clock:
    """Least milliseconds of each stage."""

    def __init__(self) -> None:
        self.least: dict[str, float] = defaultdict(lambda: float("inf"))

    def __call__(self, name: str, work: Callable[[], Any]) -> Any:
        began = time.process_time()
        value = work()
        self.least[name] = min(self.least[name], 1e3 * (time.process_time() - began))
        return value


def steps(gaussians: st.Gaussians, camera: st.Camera) -> dict[str, object]:
    """A row: what a step costs in one view."""
    stages, clock = training_stages_of("cpu"), Clock()
    learned = st.Gaussians(*(getattr(gaussians, f.name).copy() for f in fields(gaussians)))
    moments = Moments.zeros(len(learned), learned.sh.shape[1])
    slow = np.full(moments.values.shape[2], 1e-6, np.float32)
    rows, view = np.arange(len(learned), dtype=np.int32), st.View(camera, sh_degree=1)
    photo = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width, 3)).astype(np.uint8)
    for _ in range(REPEAT):
        splats = clock("project", lambda: stages.project(learned, None, rows, view, threads=1))
        bins = clock("bin", lambda s=splats: stages.bin(s, view, threads=1))
        picture = clock("blend", lambda s=splats, b=bins: stages.blend(s, b, view, threads=1))
        loss = clock("loss", lambda p=picture: stages.photo_loss(p.image, photo, np.ones(3), threads=1))
        upstream = PictureGradients(loss.image, errors=loss.errors)
        sums = clock(
            "blend backward",
            lambda s=splats, b=bins, p=picture, u=upstream: stages.blend_backward(s, b, view, p, u, threads=1),
        )
        found = clock(
            "project backward", lambda s=splats, m=sums: stages.project_backward(learned, s, m, view, threads=1)
        )
        clock("step", lambda f=found: stages.step(learned, f, moments, slow, threads=1))
    millions, least = picture.num_evaluated / 1e6, clock.least
    whole, outside = whole_step(gaussians, camera, photo)
    by_row = 1e3 * (least["project backward"] + least["step"]) / max(1, len(splats))
    return {
        "picture": f"{camera.width} × {camera.height}",
        "visible": len(splats),
        "M px-splats": round(millions, 1),
        **{f"{name} ms": round(value, 1) for name, value in least.items()},
        "all ms": round(sum(least.values()), 1),
        "blend ns/px-splat": round(least["blend"] / millions, 2),
        "backward ns/px-splat": round(least["blend backward"] / millions, 2),
        "loss ns/px": round(1e6 * least["loss"] / (camera.width * camera.height), 1),
        "µs/row": round(by_row, 3),
        "whole step ms": round(1e3 * whole, 1),
        "outside kernels %": round(100 * outside / whole, 1),
        "two threads at most %": round(100 / (1 + outside / whole), 1),
    }


def whole_step(gaussians: st.Gaussians, camera: st.Camera, photo: np.ndarray) -> tuple[float, float]:
    """Processor seconds of a step of training, and those that it spends outside compiled kernels: the least of seven."""
    rows, seen = Rows.beginning(gaussians.take(np.arange(len(gaussians)))), Sightings.none(len(gaussians))
    drawing, spent = Drawing(training_stages_of("cpu"), "classic", 1, 1), [0.0]

    def timed(kernel: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **options: Any) -> Any:
            began = time.process_time()
            value = kernel(*arguments, **options)
            spent[0] += time.process_time() - began
            return value

        return run

    kernels = {name: kernel for name, kernel in vars(_core).items() if type(kernel).__name__ == "nb_func"}
    found = []
    try:
        vars(_core).update({name: timed(kernel) for name, kernel in kernels.items()})
        for _ in range(REPEAT):
            now, spent[0], began = 1e-3 * rates(0.5, 1.0, rows.moments, 4), 0.0, time.process_time()
            learn(rows, seen, Target(camera, photo, None), np.eye(3, 4), now, 1.0, drawing)
            took = time.process_time() - began
            found.append((took, took - spent[0]))
    finally:
        vars(_core).update(kernels)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", type=Path, default=CHUNK)
    parser.add_argument("--isa", default=_core.isa(), choices=_core.isas())
    options = parser.parse_args()
    _core.use_isa(options.isa)
    gaussians = st.read(options.scene).gaussians.with_sh_degree(1)
    centre = np.median(gaussians.means, axis=0)
    eye = centre + np.array([0, -60, -80])
    rows = [steps(gaussians, st.Camera.look_at(eye, centre, width=width, height=height)) for width, height in SIZES]
    print(table(rows))
    what = f"{len(gaussians):,} Gaussians of degree 1, one thread, instruction set {options.isa}"
    save("backward", rows, about=f"Processor milliseconds of the stages of a training step: {what}.")


if __name__ == "__main__":
    main()
