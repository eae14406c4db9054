"""What a build through files costs beside a build in memory, and that both give the same tree.

``python benchmarks/scale.py [--chunks 10] [--degree 3] [--memory 1G 4G] [--workers 1 2] [--folder /tmp]`` needs the shared city.
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
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, save, table

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
    differ = [name for name, a, b in pairs if not np.array_equal(a.view(f"u{a.itemsize}"), b.view(f"u{b.itemsize}"))]
    return f"no: {', '.join(differ)}" if differ else "yes"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=10, help="chunks of the city, at most 10")
    parser.add_argument("--degree", type=int, default=3)
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
        if arguments.tiles == 1:
            in_memory = run("build", ply, tree, "--no-follow", "-q")
            wanted = st.read(tree)
            rows.append({**about, "build": "in memory", **figures(in_memory, in_memory, millions)})
        for memory, workers in product(arguments.memory, arguments.workers):
            output = folder / f"{memory}_{workers}.splatree"
            usage = run("build", *inputs, "-o", output, "--max-memory", memory, "--workers", workers, "-q")
            what = f"{memory}, {workers} process{'es' * (workers > 1)}"
            compared = {} if wanted is None else {"same tree": same(output, wanted)}
            rows.append({**about, "build": what, **figures(usage, in_memory, millions), **compared})
            print(table(rows), flush=True)
            shutil.rmtree(output)
            # Each row is kept as it comes: large builds take long.
            save(
                f"scale_degree{arguments.degree}{'_tiled' * (arguments.tiles > 1)}",
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
