"""What a build through files costs beside a build in memory, and that both give the same tree, or pictures as good.

``python benchmarks/scale.py [--chunks 10] [--degree 3] [--method radius] [--memory 1G 4G] [--workers 1 2] [--folder /tmp]`` needs
the shared city. Levels by a radius are the same bits. Levels by pairs are chosen cell by cell: views straight down on borders of
cells say how much worse cuts are within four pixels of a border and elsewhere (`seams`), beside those of the tree in memory.
``--tiles 2`` puts 2 × 2 copies of it side by side, each moved by a centimetre at random; nothing is built in memory then.
Each build is a command of its own. Memory is the largest sum over its processes of what is not backed by files (RssAnon), looked
up every 20 ms; so the pages of mapped files, which the system takes back as it likes, do not count. Linux only.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, save, table
from splatree.lod.cells import halve
from splatree.lod.region import Box
from splatree.outofcore.options import PAIR_CELL_ROWS
from splatree.outofcore.plan import SAMPLE_ROWS

NEAR_PX = 4
"""Pixels from a border that count as near."""

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")


@dataclass
class Usage:
    """What a command took."""

    cpu_s: float
    """Processor seconds of all of its processes."""
    wall_s: float
    """Seconds on the clock."""
    peak_bytes: int
    """Largest memory of all of its processes together."""


def run(*words: object) -> Usage:
    """Run a splatree command and watch it."""
    began = time.perf_counter()
    with subprocess.Popen([sys.executable, "-m", "splatree", *map(str, words)], stdout=subprocess.DEVNULL) as child:
        peak = [0]
        watcher = threading.Thread(target=watch, args=(child, peak))
        watcher.start()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        watcher.join()
    if child.returncode:
        raise SystemExit(f"splatree {' '.join(map(str, words))}: exit code {child.returncode}")
    return Usage(usage.ru_utime + usage.ru_stime, time.perf_counter() - began, peak[0])


def watch(child: "subprocess.Popen[bytes]", peak: list[int]) -> None:
    """Keep the largest memory of a process and its descendants."""
    while child.returncode is None:
        peak[0] = max(peak[0], sum(map(anonymous_bytes, descendants(child.pid))))
        time.sleep(0.02)


def descendants(pid: int) -> list[int]:
    """A process and all below it."""
    found = [pid]
    for parent in found:
        try:
            found += [
                int(each)
                for task in Path(f"/proc/{parent}/task").iterdir()
                for each in (task / "children").read_text().split()
            ]
        except OSError:
            continue
    return found


def anonymous_bytes(pid: int) -> int:
    """Memory of a process that no file backs."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("RssAnon"))


def same(folder: Path, wanted: st.Scene) -> str:
    """Whether a folder holds a tree with the same bits, but for the identities of merged nodes."""
    found, is_leaf = st.read(folder), wanted.tree.is_leaf
    if len(found) != len(wanted):
        return f"no: {len(found)} rows for {len(wanted)}"
    pairs = [(name, getattr(found.gaussians, name), getattr(wanted.gaussians, name)) for name in COLUMNS]
    pairs += [
        (name, getattr(found.tree, name), getattr(wanted.tree, name)) for name in ("subtree_end", "depth", "extents")
    ]
    pairs += [("ids of leaves", found.ids[is_leaf], wanted.ids[is_leaf])]
    if wanted.tree.curves is not None and found.tree.curves is not None:
        pairs.append(("curves", found.tree.curves, wanted.tree.curves))
    differ = ["curves"] if (wanted.tree.curves is None) != (found.tree.curves is None) else []
    differ += [name for name, a, b in pairs if not np.array_equal(a.view(f"u{a.itemsize}"), b.view(f"u{b.itemsize}"))]
    return f"no: {', '.join(differ)}" if differ else "yes"


def seams(folder: Path, wanted: st.Scene, part_rows: int) -> dict[str, float]:
    """How near cuts of a folder are to all leaves, less how near those of the tree in memory are, on borders of cells, dB.

    A border through the middle of a picture that looks straight down is a straight line in it, however high things stand. The
    strip of 8 px along it is compared, and, as a measure of chance, 20 strips of the same width elsewhere in each picture: trees
    of other pairs differ everywhere. All views together have the mean of their squared errors; errors below 50 dB count as such.
    """
    means = wanted.gaussians.means[wanted.tree.is_leaf]
    sample = np.array(means[:: len(means) // SAMPLE_ROWS + 1])
    low, high = np.quantile(sample, (0.05, 0.95), axis=0)
    near, away, nodes = list[np.ndarray](), list[np.ndarray](), list[float]()
    tree = st.read(folder)
    for axis, at, side_low, side_high in borders(halve(sample, part_rows * len(sample) / len(means)).boxes, low, high):
        middle = (side_low + side_high) / 2
        middle[axis] = at
        ground = sample[np.abs(sample - middle)[:, [0, 2]].max(axis=1) < 20][:, 1]
        if len(ground) < 100:
            continue
        middle[1] = np.median(ground)
        for height in (40.0, 160.0):
            eye = middle - np.array([0, height, 0])  # y points down
            camera = st.Camera.look_at(eye, middle, up=(0, 0, 1), width=480, height=480, fov_y_deg=50)
            every = np.clip(st.render(wanted, camera, select=st.SelectOptions(pixel_error=0.0)).image, 0, 1)
            cuts = [st.render(each, camera) for each in (tree, wanted)]
            # World x runs along the columns of the picture, z along its rows: the border is made a column.
            errors = np.stack([np.mean((np.clip(cut.image, 0, 1) - every) ** 2, axis=2) for cut in cuts])
            columns = (errors if axis == 0 else errors.transpose(0, 2, 1)).mean(axis=1)
            near.append(columns[:, 240 - NEAR_PX : 240 + NEAR_PX].mean(axis=1))
            others = np.delete(columns.reshape(2, -1, 2 * NEAR_PX).mean(axis=2), [29, 30], axis=1)
            away += list(others[:, ::3].T)
            ours, whole = (cut.counters.num_selected for cut in cuts)
            nodes.append(ours / whole)
    gains = {name: np.array([decibels(*each) for each in errors]) for name, errors in (("near", near), ("away", away))}
    return {
        "near borders, dB": decibels(*np.mean(near, axis=0)),
        "worst near borders, dB": float(gains["near"].min()),
        "elsewhere, dB": decibels(*np.mean(away, axis=0)),
        "worst elsewhere, dB": float(gains["away"].min()),
        "nodes drawn / in memory": float(np.mean(nodes)),
        "border views": len(near),
    }


def decibels(ours: float, whole: float) -> float:
    """By how much an error is smaller than another one; what is below 50 dB is not seen."""
    return float(10 * np.log10(max(whole, 1e-5) / max(ours, 1e-5)))


def borders(boxes: Sequence[Box], low: np.ndarray, high: np.ndarray) -> list[tuple[int, float, np.ndarray, np.ndarray]]:
    """Upright sides of boxes: the axis that each is across, where, and its corners, within those of the scene."""
    sides = []
    for box in boxes:
        corners = np.maximum(box.low, low), np.minimum(box.high, high)
        sides += [
            (axis, box.high[axis], *(c.copy() for c in corners)) for axis in (0, 2) if box.high[axis] < high[axis]
        ]
    return sides


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=10, help="chunks of the city, at most 10")
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--method", choices=("radius", "pairs"), default="radius")
    parser.add_argument("--memory", nargs="+", default=["1G", "4G"])
    parser.add_argument("--tiles", type=int, default=1, help="copies along each side")
    parser.add_argument("--workers", type=int, nargs="+", default=[1])
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    city = DATA / "trained" / "semarang_city"
    chunks = sorted(path for path in city.iterdir() if path.is_dir())[: arguments.chunks]
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder = Path(name)
        ply, tree = folder / "city.ply", folder / "memory.splatree"
        st.convert(chunks, ply, st.ConvertOptions(edit=st.EditOptions(sh_degree=arguments.degree)))
        inputs, wanted, in_memory = tiles_of(ply, arguments.tiles), None, None
        num_leaves = len(st.read(ply)) * arguments.tiles**2
        millions, about = num_leaves / 1e6, {"Gaussians": num_leaves, "degree": arguments.degree}
        rows: list[dict[str, object]] = []
        by_pairs = arguments.method == "pairs"
        words = ("--method", arguments.method)
        if arguments.tiles == 1:
            in_memory = run("build", ply, tree, *words, "-q")
            wanted = st.read(tree)
            rows.append({**about, "build": "in memory", **figures(in_memory, in_memory, millions)})
        for memory, workers in product(arguments.memory, arguments.workers):
            output = folder / f"{memory}_{workers}.splatree"
            usage = run("build", *inputs, "-o", output, *words, "--max-memory", memory, "--workers", workers, "-q")
            what = f"{memory}, {workers} process{'es' * (workers > 1)}"
            compared: dict[str, object] = {}
            if wanted is not None:
                compared = seams(output, wanted, PAIR_CELL_ROWS) if by_pairs else {"same tree": same(output, wanted)}
            rows.append({**about, "build": what, **figures(usage, in_memory, millions), **compared})
            print(table(rows), flush=True)
            shutil.rmtree(output)
            # Each row is kept as it comes: large builds take long.
            save(
                f"scale{'_pairs' * by_pairs}_degree{arguments.degree}{'_tiled' * (arguments.tiles > 1)}",
                rows,
                about="Building the real city through files, beside the build in memory",
            )


def tiles_of(ply: Path, side: int) -> list[Path]:
    """Files of copies of a scene side by side."""
    if side == 1:
        return [ply]
    gaussians, rng, paths = st.read(ply).gaussians, np.random.default_rng(0), []
    low, high = np.quantile(gaussians.means, (0.01, 0.99), axis=0)
    for x, z in product(range(side), range(side)):  # y is up
        moved = gaussians.means + (high - low) * [x, 0, z] + rng.normal(0, 0.01, gaussians.means.shape)
        paths.append(ply.with_name(f"tile_{x}_{z}.ply"))
        st.write(st.Scene.flat(replace(gaussians, means=moved.astype(np.float32))), paths[-1])
    return paths


def figures(usage: Usage, in_memory: Usage | None, millions: float) -> dict[str, float]:
    """The columns of a row."""
    return {
        "CPU s a million": usage.cpu_s / millions,
        **({} if in_memory is None else {"CPU / in memory": usage.cpu_s / in_memory.cpu_s}),
        "peak MB": usage.peak_bytes / 1e6,
    }


if __name__ == "__main__":
    main()
