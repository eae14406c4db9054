"""What thinning a real scene costs: by radius and to a share, for growing scenes, with the slope between them.

``python benchmarks/thin.py [--counts 1000000 3000000] [--degree 3] [--peer]`` needs the shared city. Scenes above its 5 M are
the city repeated beside itself. ``--peer`` also runs splat-transform (npm, @playcanvas/splat-transform) on one chunk where
npx is there, against ours on the same file.
"""

import argparse
import math
import shutil
import tempfile
from pathlib import Path

import numpy as np

import splatree
from harness import DATA, measure, save, table

CITY = DATA / "trained" / "semarang_city"
PEER = "@playcanvas/splat-transform@3.7.0"


def city(count: int, degree: int) -> splatree.Gaussians:
    """The first ``count`` Gaussians of the city, repeated with an offset where it has fewer."""
    gaussians = splatree.read(sorted(path for path in CITY.iterdir() if path.is_dir())).gaussians.with_sh_degree(degree)
    parts = []
    while count > 0:
        part = gaussians if count >= len(gaussians) else gaussians.take(np.arange(count))
        offset = np.float32([1500.0 * len(parts), 0, 0])
        parts.append(splatree.Gaussians(part.means + offset, *(getattr(part, f) for f in FIELDS)))
        count -= len(part)
    return parts[0] if len(parts) == 1 else splatree.Gaussians.concatenate(parts)


FIELDS = ("quats", "log_scales", "logit_opacities", "sh")


def slope(small: dict[str, object], large: dict[str, object]) -> float:
    """Exponent of the growth of CPU time with the count."""
    return math.log(large["CPU s"] / small["CPU s"]) / math.log(large["Gaussians"] / small["Gaussians"])  # type: ignore


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[1_000_000, 3_000_000])
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--peer", action="store_true")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    jobs = {
        "radius auto": splatree.ThinOptions(),
        "radius, keep 10 %": splatree.ThinOptions("radius", keep=0.1),
        "pairs, keep 50 %": splatree.ThinOptions("pairs", keep=0.5),
        "pairs, keep 10 %": splatree.ThinOptions("pairs", keep=0.1),
    }
    for count in arguments.counts:
        scene = splatree.Scene.flat(city(count, arguments.degree))
        for name, options in jobs.items():
            cost = measure(lambda s=scene, o=options: splatree.thin(s, o))
            groups = cost.value.groups
            row: dict[str, object] = {
                "what": f"thin, {name}",
                "Gaussians": count,
                "kept": len(groups) / count,
                "CPU s": cost.cpu_s,
                "wall s": cost.wall_s,
                "peak MB": cost.peak_bytes / 1e6,
                "input MB": scene.gaussians.nbytes / 1e6,
                "rounds": groups.rounds,
                "visited / row": groups.num_visited / count,
            }
            before = next((r for r in rows if r["what"] == row["what"]), None)
            rows.append(row | {"slope": slope(before, row) if before else ""})
            print(rows[-1], flush=True)
        del scene
    if arguments.peer and shutil.which("npx"):
        rows += against_peer()
    print(table(rows))
    save(
        "thin",
        rows,
        about="Thinning the real city: processor seconds, memory, rounds of parallel decisions, neighbours visited",
    )


def against_peer() -> list[dict[str, object]]:
    """splat-transform's decimation and ours, one chunk to 10 %, reading and writing included in both."""
    chunk = CITY / "5_1"
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        source, target = chunk / "meta.json", Path(folder) / "out.ply"
        commands = {
            f"{PEER} -g cpu -d 10%": ["npx", "--yes", PEER, "-w", "-g", "cpu", source, "-d", "10%", target],
            "splatree thin --keep 0.1": ["splatree", "thin", source, target, "--keep", "0.1", "--force"],
        }
        for name, command in commands.items():
            if shutil.which(command[0]) is None:
                continue
            cost = measure(command)
            rows.append(
                {
                    "what": f"{name} (whole run)",
                    "Gaussians": len(splatree.read(chunk)),
                    "kept": len(splatree.read(target)) / len(splatree.read(chunk)),
                    "CPU s": cost.cpu_s,
                    "wall s": cost.wall_s,
                    "peak MB": cost.peak_bytes / 1e6,
                }
            )
    return rows


if __name__ == "__main__":
    main()
