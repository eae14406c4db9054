"""Scenes from photographs: quality on held-out photographs after a budget of processor seconds, one thread.

``python benchmarks/train.py`` runs all but those of more than ten minutes; names of runs as arguments choose some, and keep the
rows of the others. With ``--files FOLDER`` an interrupt (Ctrl-C) leaves a checkpoint there, and the same command goes on. The
runs named ``points`` and ``cells`` begin alike but for one thing: with the points of the cameras' model alone, or with a Gaussian
in each empty cell of the photographs, and of what lies beyond their borders, too.
"""

import argparse
import importlib
import json
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import harness
import splatree as st
from splatree.metrics.gain import psnr_with_gain
from splatree.train.exposure import exposed
from splatree.train.targets import Target, Targets


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
    """Whether training begins in empty cells and beyond the borders, too."""


RUNS = {
    "plush-30": Run("snowmiku_plush_small", 30, 50_000),
    "drone-60": Run("caliterra_drone", 60, 120_000),
    "drone-240": Run("caliterra_drone", 240, 120_000),
    "drone-720": Run("caliterra_drone", 720, 300_000),
    "drone-1800": Run("caliterra_drone", 1800, 300_000),
    "plush-points": Run("snowmiku_plush_small", 0, 50_000, iterations=400, fills_cells=False),
    "plush-cells": Run("snowmiku_plush_small", 0, 50_000, iterations=400),
    "drone-points": Run("caliterra_drone", 0, 50_000, iterations=400, fills_cells=False),
    "drone-cells": Run("caliterra_drone", 0, 50_000, iterations=400),
}

LONG_S = 600
"""Runs of more processor seconds are made when they are named."""

COVERED = (0, 1, 2, 4, 8)
"""Pixels are told apart by the number of training photographs that show the same place: at least so many."""

EVERY = 6
"""Each n-th training photograph is scored at the end, to see how much better known pictures are drawn."""


ABOUT = """Held-out photographs (every 8th) at half of their size: PSNR as rendered, with a gain for each channel fitted on the
left half and scored on the right half, and SSIM. The last row of a run has the PSNR of each sixth training photograph with its
own exposure, and fitted as the others.""".replace("\n", " ")

ABOUT_COVERAGE = """Pixels of held-out photographs, and of each sixth training photograph, told apart by how many other training
photographs show the place that they show (by the depth that is drawn): PSNR after a gain for each channel fitted on the whole
picture.""".replace("\n", " ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", choices=[*RUNS, []])
    parser.add_argument("--files", type=Path)
    options = parser.parse_args()
    chosen = options.runs or [name for name, run in RUNS.items() if run.cpu_s <= LONG_S]
    for name in chosen:
        rows, pixels = trained(name, RUNS[name], options.files)
        save("train", name, rows, ABOUT)
        if not pixels:
            sys.exit(f"{name}: interrupted; the same command goes on")
        save("train_coverage", name, pixels, ABOUT_COVERAGE)


def save(result: str, run: str, rows: list[dict[str, Any]], about: str) -> None:
    """Print the rows of a run, and keep them beside those of the others."""
    print(harness.table(rows))
    path = harness.RESULTS / f"{result}.json"
    kept = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [*(row for row in kept if row["run"] != run), *rows]
    harness.save(result, sorted(rows, key=lambda row: list(RUNS).index(row["run"])), about=about)


def trained(name: str, run: Run, files: Path | None) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The scores of one training in its course, and by coverage at its end, if it comes to it; runs are kept below ``files``."""
    folder = harness.DATA / "images" / run.photographs
    if not folder.is_dir():
        sys.exit(f"{folder}: not found, wanted the shared photographs")
    if run.iterations is None:
        options = st.TrainOptions(minutes=run.cpu_s / 60, max_gaussians=run.max_gaussians)
    else:
        options = st.TrainOptions(iterations=run.iterations, max_gaussians=run.max_gaussians)
    prepare = importlib.import_module("splatree.train.prepare")
    fills = {name: getattr(prepare, name) for name in ("fill_empty_cells", "add_apron")}

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
        for fill in fills:
            setattr(prepare, fill, lambda gaussians, *others, **more: gaussians)
    kept = st.RunFiles() if files is None else st.RunFiles(files / name, resume=(files / name).is_dir())
    interrupted: list[int] = []
    if files is not None:
        signal.signal(signal.SIGINT, lambda number, frame: interrupted.append(number))
    try:
        found = st.train(
            folder,
            options,
            files=kept,
            stop=lambda: bool(interrupted),
            threads=1,
            watch=lambda scored: print(row(scored), flush=True),
        )
    finally:
        for fill, original in fills.items():
            setattr(prepare, fill, original)
    rows = [row(scored) for scored in found.history]
    if found.stopped:
        return rows, []
    rows[-1]["training"], rows[-1]["training fitted"] = known(found, folder)
    return rows, [{"run": name, **pixels} for pixels in by_coverage(found, folder)]


def known(found: st.Trained, folder: Path) -> tuple[float, float]:
    """Mean PSNR of some training photographs, dB: with their own exposures, and fitted as held-out ones are."""
    scores = []
    for target in pictures(found, folder, list(found.exposures)[::EVERY]):
        photo, image = target.photo / np.float32(255), st.render(found.scene, target.camera).image
        own = np.clip(exposed(image, found.exposures[target.camera.name]), 0, 1)
        scores.append((st.psnr(own, photo), psnr_with_gain(image, photo)))
    own, fitted = np.mean(scores, axis=0)
    return float(own), float(fitted)


def by_coverage(found: st.Trained, folder: Path) -> list[dict[str, Any]]:
    """PSNR of pixels by the number of training photographs that show the same place, with a gain fitted on each picture."""
    views = st.read_cameras(folder, source=found.scene.source)
    training = [view for view in views if view.name in found.exposures]
    groups = {
        "held out": [view.name for view in views if view.name not in found.exposures],
        "training": [view.name for view in training][::EVERY],
    }
    rows = []
    for label, names in groups.items():
        errors, counts = np.zeros(len(COVERED)), np.zeros(len(COVERED))
        for target in pictures(found, folder, names):
            drawn = st.render(found.scene, target.camera)
            photo = target.photo / np.float64(255)
            gain = (drawn.image * photo).sum((0, 1)) / np.square(drawn.image, dtype=np.float64).sum((0, 1))
            error = np.square(np.clip(drawn.image * gain, 0, 1) - photo).mean(axis=2)
            shown = covered(target.camera, drawn.depth, [view for view in training if view.name != target.camera.name])
            which = np.searchsorted(COVERED, shown, side="right") - 1
            errors += np.bincount(which.ravel(), error.ravel(), len(COVERED))
            counts += np.bincount(which.ravel(), minlength=len(COVERED))
        for i, (few, many) in enumerate(zip(COVERED, (*COVERED[1:], None), strict=True)):
            rows.append(
                {
                    "photographs": label,
                    "other photographs of the place": f"{few} to {many - 1}" if many else f"{few} and more",
                    "share of the pixels": counts[i] / counts.sum(),
                    "share of the error": errors[i] / errors.sum(),
                    "PSNR": -10 * np.log10(errors[i] / counts[i]) if counts[i] else None,
                }
            )
    return rows


def covered(camera: st.Camera, depth: np.ndarray, others: list[st.Camera]) -> np.ndarray:
    """How many other views each pixel's point lies in, by the depth that is drawn there; what hides it is not asked."""
    depth = np.where(depth > 0, depth, np.median(depth[depth > 0]))
    row, column = np.mgrid[: camera.height, : camera.width] + 0.5
    slopes = np.stack([column - camera.K[0, 2], row - camera.K[1, 2]], axis=-1) / np.diag(camera.K)[:2]
    seen = np.concatenate([slopes, np.ones((*depth.shape, 1))], axis=2) * depth[..., None]
    world = (seen - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]
    count = np.zeros(depth.shape, np.int64)
    for other in others:
        point = world @ other.camera_from_world[:3, :3].T + other.camera_from_world[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = point[..., :2] / point[..., 2:] * np.diag(other.K)[:2] + other.K[:2, 2]
        inside = ((pixel >= 0) & (pixel < (other.width, other.height))).all(axis=2)
        count += inside & (point[..., 2] > other.near)
    return count


def pictures(found: st.Trained, folder: Path, names: list[str]) -> Iterator[Target]:
    """Photographs with their cameras in the world of the scene, at the size that it was trained at."""
    division = json.loads(found.scene.source.metadata["training"])["division"]
    targets = Targets(folder, [view for view in st.read_cameras(folder) if view.name in names])
    targets.placed(found.scene.source.near, np.asarray(found.scene.source.origin))
    for i in range(len(targets)):
        yield targets.at(i, division)


if __name__ == "__main__":
    main()
