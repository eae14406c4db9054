"""What building the levels of a real scene costs, and what the tree looks like.

``python benchmarks/build.py [--counts 1000000] [--degree 3]`` needs the shared city; 10 M at degree 0 are
``--counts 1000000 10000000 --degree 0 --method radius``. Cost is after loading; the peak includes the loaded scene. Two builds
in one process show how much they differ.
"""

import argparse
from itertools import product

import splatree
from harness import measure, save, table
from splatree.lod.report import report_levels
from thin import city, slope

WAYS = {
    "auto": splatree.BuildOptions(),
    "pairs": splatree.BuildOptions("pairs"),
    "radius": splatree.BuildOptions("radius"),
    "fast": splatree.BuildOptions("radius", visibility=False),
}
"""As `build` makes levels by default, by `--method`, and by `--fast`."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[1_000_000])
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--method", nargs="+", choices=WAYS, default=list(WAYS))
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for count, method in product(arguments.counts, arguments.method):
        scene, options = splatree.Scene.flat(city(count, arguments.degree)), WAYS[method]
        cost = measure(lambda s=scene, o=options: splatree.build_lod(s, o))
        again_s = measure(lambda s=scene, o=options: splatree.build_lod(s, o)).cpu_s
        report = report_levels(cost.value)
        inner = report.num_nodes - report.num_leaves
        row: dict[str, object] = {
            "Gaussians": count,
            "degree": arguments.degree,
            "method": method,
            "CPU s": cost.cpu_s,
            "CPU s, again": again_s,
            "wall s": cost.wall_s,
            "peak MB": cost.peak_bytes / 1e6,
            "input MB": scene.gaussians.nbytes / 1e6,
            "output MB": report.num_bytes / 1e6,
            "nodes / leaves": report.num_nodes / report.num_leaves,
            "roots": report.num_roots,
            "levels": len(report.nodes_per_depth),
            "mean fan-out": (report.num_nodes - report.num_roots) / max(1, inner),
            "pairs among inner": report.fan_out.get(2, 0) / max(1, inner),
        }
        first = next((before for before in rows if before["method"] == method), None)
        rows.append(row | {"slope": slope(first, row) if first else ""})
        print("nodes per depth:", *report.nodes_per_depth, flush=True)
        del scene, cost
    print(table(rows))
    save(f"build_degree{arguments.degree}", rows, about="Building all levels of the real city, after loading")


if __name__ == "__main__":
    main()
