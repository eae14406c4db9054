"""Scenes from photographs: quality on held-out photographs after a budget of processor seconds, one thread.

``python benchmarks/train.py`` runs all; names of runs as arguments choose some, and keep the rows of the others. The runs named
``points`` and ``cells`` begin alike but for one thing: with the points of the cameras' model alone, or with a Gaussian in each
empty cell of the photographs too.
"""

import importlib
import json
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

import harness
import splatree as st
from splatree.metrics.gain import psnr_with_gain
from splatree.train.exposure import exposed
from splatree.train.targets import divided


@dataclass(frozen=True)
class Run:
    """One training."""

    photographs: str
    """Folder in the shared data."""
    cpu_s: float
    """Processor seconds."""
    max_gaussians: int
    """Gaussians at most."""
    iterations: int | None = None
    """Steps instead of seconds."""
    fills_cells: bool = True
    """Whether training begins in empty cells, too."""


RUNS = {
    "plush-30": Run("snowmiku_plush_small", 30, 50_000),
    "drone-60": Run("caliterra_drone", 60, 120_000),
    "drone-240": Run("caliterra_drone", 240, 120_000),
    "plush-points": Run("snowmiku_plush_small", 0, 50_000, iterations=400, fills_cells=False),
    "plush-cells": Run("snowmiku_plush_small", 0, 50_000, iterations=400),
    "drone-points": Run("caliterra_drone", 0, 50_000, iterations=400, fills_cells=False),
    "drone-cells": Run("caliterra_drone", 0, 50_000, iterations=400),
}

EVERY = 6
"""Each n-th training photograph is scored at the end, to see how much better known pictures are drawn."""


def main() -> None:
    chosen = sys.argv[1:] or list(RUNS)
    path = harness.RESULTS / "train.json"
    kept = json.loads(path.read_text())["rows"] if sys.argv[1:] and path.exists() else []
    rows = [row for row in kept if row["run"] not in chosen]
    for name in chosen:
        rows += trained(name, RUNS[name])
    print(harness.table(rows))
    about = (
        "Held-out photographs (every 8th) at half of their size: PSNR as rendered, with a gain for each channel fitted on the "
        "left half and scored on the right half, and SSIM. The last row of a run has the PSNR of each sixth training photograph "
        "with its own exposure, and fitted as the others."
    )
    harness.save("train", sorted(rows, key=lambda row: list(RUNS).index(row["run"])), about=about)


def trained(name: str, run: Run) -> list[dict[str, Any]]:
    """The scores of one training in its course."""
    folder = harness.DATA / "images" / run.photographs
    if not folder.is_dir():
        sys.exit(f"{folder}: not found, wanted the shared photographs")
    if run.iterations is None:
        options = st.TrainOptions(minutes=run.cpu_s / 60, max_gaussians=run.max_gaussians)
    else:
        options = st.TrainOptions(iterations=run.iterations, max_gaussians=run.max_gaussians)
    prepare = importlib.import_module("splatree.train.prepare")
    filled = prepare.fill_empty_cells

    def row(scored: st.Scored) -> dict[str, Any]:
        assert scored.score is not None
        return {
            "run": name,
            "CPU s": scored.cpu_s,
            "steps": scored.iterations,
            "ms a step": 1000 * scored.cpu_s / scored.iterations,
            "Gaussians": scored.num_gaussians,
            "PSNR": scored.score.psnr,
            "fitted": scored.score.psnr_fitted,
            "SSIM": scored.score.ssim,
        }

    if not run.fills_cells:
        prepare.fill_empty_cells = lambda gaussians, *others, **more: gaussians
    try:
        found = st.train(folder, options, threads=1, watch=lambda scored: print(row(scored), flush=True))
    finally:
        prepare.fill_empty_cells = filled
    rows = [row(scored) for scored in found.history]
    rows[-1]["training"], rows[-1]["training fitted"] = known(found, folder)
    return rows


def known(found: st.Trained, folder: Any) -> tuple[float, float]:
    """Mean PSNR of some training photographs, dB: with their own exposures, and fitted as held-out ones are."""
    record = json.loads(found.scene.source.metadata["training"])
    scores = []
    for camera in [c for c in st.read_cameras(folder) if c.name in found.exposures][::EVERY]:
        photo = st.read_image(folder / "images" / camera.name)
        division, small = record["division"], divided(camera, record["division"])
        photo = photo[: small.height * division, : small.width * division]
        photo = photo.reshape(small.height, division, small.width, division, 3).mean(axis=(1, 3))
        image = st.render(found.scene, small).image
        own = np.clip(exposed(image, found.exposures[camera.name]), 0, 1)
        scores.append((st.psnr(own, photo), psnr_with_gain(image, photo.astype(np.float32))))
    own, fitted = np.mean(scores, axis=0)
    return float(own), float(fitted)


if __name__ == "__main__":
    main()
