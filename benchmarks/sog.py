"""Writing and reading SOG: cost, size and quality; the palette of harmonics against exact K-means.

``python benchmarks/sog.py [--count 1000000] [--peer splat-transform] [--gaussforge PYTHON]`` needs the shared city. Its harmonics
come from palettes of others; so that they are like those of a training, noise of a third of their size is added to every
coefficient. The peer writes the same rows without harmonics (degree 0): with them its processor path takes hours. Quality is PSNR
against what was written, mean and least of eight views. "WebP alone" is what Pillow's libwebp takes to pack and unpack the same
pictures at the same settings: no writer or reader that uses it can be cheaper than that.

GaussForge (PyPI: gaussforge), in the Python that --gaussforge names, writes harmonics too; it gets ``--gaussforge-count`` rows,
which take it minutes, and splatree the same.
"""

import argparse
import io
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import splatree
from harness import DATA, Cost, measure, save, table
from splatree import Scene
from splatree.io.formats.sog.palette import find_palette
from splatree.io.formats.sog.writer import WEBP_METHOD, WEBP_QUALITY

CITY = DATA / "trained" / "semarang_city"
CHUNKS = ("5_1", "5_4", "5_7", "5_9")
NOISE = 0.03
OURS = "import sys; from splatree.io.convert import convert; convert(*sys.argv[1:])"
SUBSET, ENTRIES, ROUNDS = 30_000, 2048, 8


def scene_of(count: int) -> Scene:
    """``count`` rows of the city, with noise on the harmonics beyond the DC."""
    scene = splatree.read([CITY / chunk for chunk in CHUNKS])
    rng = np.random.default_rng(0)
    g = scene.gaussians.take(np.sort(rng.permutation(len(scene))[:count]))
    g.sh[:, 1:] += rng.normal(0, NOISE, g.sh[:, 1:].shape).astype(np.float32)
    return Scene.flat(g, mode=scene.mode)


def quality(scene: Scene, written: Scene) -> np.ndarray:
    """PSNR of each view."""
    paths = splatree.PathOptions(views=4)
    cameras = [camera.scaled(0.5) for path in (splatree.orbit, splatree.flyout) for camera in path(scene, paths)]
    pictures = ([np.clip(splatree.render(s, c).image, 0, 1) for c in cameras] for s in (scene, written))
    return np.array([splatree.psnr(a, b) for a, b in zip(*pictures, strict=True)])


def exact_kmeans_error(x: np.ndarray, entries: int) -> float:
    """Mean squared error of Lloyd's rounds with a full search."""
    centres = x[np.random.default_rng(0).choice(len(x), entries, replace=False)]
    for _ in range(ROUNDS + 1):
        scores = (centres**2).sum(axis=1) - 2 * x @ centres.T
        labels = scores.argmin(axis=1)
        error = float(np.mean(scores[np.arange(len(x)), labels] + (x**2).sum(axis=1)))
        counts = np.bincount(labels, minlength=entries)
        sums = np.zeros_like(centres)
        np.add.at(sums, labels, x)
        centres = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centres)
    return error


def palette_rows(scene: Scene) -> list[dict[str, Any]]:
    """Cost and error of the palette and of exact K-means on a subset, or on all of a small scene, without weights."""
    step = max(1, len(scene) // SUBSET)
    sh = scene.gaussians.sh[: SUBSET * step : step].copy()
    x = sh[:, 1:].reshape(len(sh), -1)
    entries = min(ENTRIES, len(sh))
    spread = float(np.mean(((x - x.mean(axis=0)) ** 2).sum(axis=1)))
    ours = measure(lambda: find_palette(lambda: [sh], np.ones(len(sh), np.float32), entries))
    exact = measure(lambda: exact_kmeans_error(x, entries))
    error = float(np.mean(((sh[:, 1:] - ours.value.entries[ours.value.labels]) ** 2).sum(axis=(1, 2))))
    about = f"{len(sh):,} rows, {entries:,} entries"
    return [
        {"work": f"palette, {about}", "CPU s": ours.cpu_s, "error / variance": error / spread},
        {"work": f"exact K-means, {about}", "CPU s": exact.cpu_s, "error / variance": exact.value / spread},
    ]


def webp_alone(path: Path) -> dict[str, Any]:
    """Packing and unpacking the pictures of a bundle, and nothing else."""
    with zipfile.ZipFile(path) as bundle:
        packed = [bundle.read(name) for name in bundle.namelist() if name.endswith(".webp")]
    unpack = measure(lambda: [Image.open(io.BytesIO(data)).copy() for data in packed], repeat=3)

    def pack() -> None:
        for image in unpack.value:
            image.save(io.BytesIO(), "WEBP", lossless=True, exact=True, method=WEBP_METHOD, quality=WEBP_QUALITY)

    return {"CPU s": measure(pack).cpu_s, "read CPU s": unpack.cpu_s}


GAUSSFORGE = """
import sys, gaussforge
source, target = sys.argv[1:]
with open(source, "rb") as file:
    done = gaussforge.GaussForge().convert(file.read(), "ply", "sog")
if "error" in done:
    sys.exit(done["error"])
with open(target, "wb") as file:
    file.write(done["data"])
"""


def gaussforge_rows(scene: Scene, python: str, count: int, folder: Path) -> list[dict[str, Any]]:
    """GaussForge and splatree, each from the same .ply with harmonics."""
    few = Scene.flat(scene.gaussians.take(np.arange(min(count, len(scene)))), mode=scene.mode)
    splatree.write(few, folder / "few.ply")
    rows = []
    for name, command in (
        ("GaussForge", [python, "-c", GAUSSFORGE, folder / "few.ply", folder / "gaussforge.sog"]),
        ("splatree", [sys.executable, "-c", OURS, folder / "few.ply", folder / "ours.sog"]),
    ):
        cost, out = measure(command), Path(command[-1])
        db = quality(few, splatree.read(out))
        rows.append(written_row(f"{name}, degree 3, from .ply", len(few), cost, out, db))
    return rows


def written_row(work: str, num_gaussians: int, cost: Cost, path: Path, db: np.ndarray) -> dict[str, Any]:
    """A line of the table: what writing a file took, and how near it is."""
    return {
        "work": work,
        "Gaussians": num_gaussians,
        "CPU s": cost.cpu_s,
        "wall s": cost.wall_s,
        "peak MB": round(cost.peak_bytes / 1e6),
        "MB": path.stat().st_size / 1e6,
        "PSNR mean": float(db.mean()),
        "PSNR least": float(db.min()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--peer", default="splat-transform", help="command of the peer; left out if it is not there")
    parser.add_argument("--gaussforge", default=None, help="a Python that has gaussforge; left out if it is not given")
    parser.add_argument("--gaussforge-count", type=int, default=100_000)
    arguments = parser.parse_args()
    if not CITY.is_dir():
        raise SystemExit(f"needs the city at {CITY}")
    scene = scene_of(arguments.count)
    flat_colour = Scene.flat(scene.gaussians.with_sh_degree(0), mode=scene.mode)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for degree, s in ((3, scene), (0, flat_colour)):
            path = Path(folder) / f"{degree}.sog"
            wrote = measure(lambda s=s, path=path: splatree.write(s, path))
            read = measure(lambda path=path: splatree.read(path))
            db = quality(s, read.value)
            written = written_row(f"splatree, degree {degree}", len(s), wrote, path, db)
            rows.append(written | {"read CPU s": read.cpu_s})
            rows.append({"work": f"WebP alone, degree {degree}", "Gaussians": len(s), **webp_alone(path)})
        if arguments.gaussforge:
            rows += gaussforge_rows(scene, arguments.gaussforge, arguments.gaussforge_count, Path(folder))
        if tool := shutil.which(arguments.peer):
            ply, out = Path(folder) / "0.ply", Path(folder) / "peer.sog"
            splatree.write(flat_colour, ply)
            cost = measure([tool, "-q", "-g", "cpu", ply, out])
            db = quality(flat_colour, splatree.read(out))
            rows.append(written_row("splat-transform, degree 0, from .ply", len(scene), cost, out, db))
    rows += palette_rows(scene)
    print(table(rows))
    save(
        "sog",
        rows,
        about="Writing SOG: cost, size, quality of the picture; the palette of harmonics against exact K-means.",
    )


if __name__ == "__main__":
    main()
