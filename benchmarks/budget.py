"""What a budget of a tenth of the leaves shows of a whole city, from high above down to the ground.

``python benchmarks/budget.py [--mode classic antialiased] [--share 0.1]`` needs the shared city and its flight of 16 views, which
sinks from 180 to 50 m. Each view is drawn from a cut of at most ``share`` of the city's leaves, from levels by pairs and by a
radius and, in mode `classic`, from levels by pairs that were merged for pixels much smaller than themselves
(``--dilation 0``); beside them the whole city thinned once to the same share, of which a view sees only its part. PSNRs are
against all leaves, drawn by the same renderer.
"""

import argparse
from collections.abc import Iterator
from typing import get_args

import numpy as np

import splatree
from harness import DATA, save, table
from splatree.metrics.psnr import psnr
from splatree.scene.names import Mode

CITY = DATA / "trained" / "semarang_city"
VIEWS = DATA / "cameras" / "semarang_city_made_views.json"
FLIGHT = range(0, 16, 3)
"""Every third view of the flight: heights of 180, 154, 128, 102, 76 and 50 m."""
ALL_LEAVES = splatree.SelectOptions(pixel_error=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mode", nargs="+", choices=get_args(Mode), default=list(get_args(Mode)))
    parser.add_argument("--share", type=float, default=0.1, help="budget over the leaves of the city")
    arguments = parser.parse_args()
    if not CITY.is_dir() or not VIEWS.is_file():
        raise SystemExit(f"needs the city at {CITY} and its views at {VIEWS}")
    leaves = splatree.read(sorted(path.parent for path in CITY.glob("*/meta.json"))).gaussians
    views = splatree.read_cameras(VIEWS)
    cameras = [views[i] for i in FLIGHT]
    rows: list[dict[str, object]] = []
    for mode in arguments.mode:
        rows += of_mode(splatree.Scene.flat(leaves, mode=mode), cameras, arguments.share)
        print(table([row for row in rows if row["mode"] == mode]), end="\n\n", flush=True)
    save(
        "budget",
        rows,
        about=f"{len(leaves):,} leaves of a city, six views sinking from 180 to 50 m: a cut of at most "
        f"{arguments.share:.0%} of the leaves, and the whole city thinned once to that share, PSNR against all leaves",
    )


def of_mode(city: splatree.Scene, cameras: list[splatree.Camera], share: float) -> Iterator[dict[str, object]]:
    """Shares of the leaves in view, then PSNR, share drawn and τ_R of each way."""
    full = [splatree.trace(city, camera, select=ALL_LEAVES) for camera in cameras]
    num_leaves = len(city.gaussians)

    def row(way: str, what: str, values: list[float]) -> dict[str, object]:
        return {"mode": city.mode, "drawn": way, "what": what} | {
            c.name: v for c, v in zip(cameras, values, strict=True)
        }

    def rows_of(way: str, scene: splatree.Scene, select: splatree.SelectOptions) -> Iterator[dict[str, object]]:
        frames = [splatree.trace(scene, camera, select=select) for camera in cameras]
        pictures = [np.clip(frame.result.image, 0, 1) for frame in frames]
        yield row(way, "PSNR", [psnr(p, np.clip(f.result.image, 0, 1)) for p, f in zip(pictures, full, strict=True)])
        yield row(way, "% of leaves", [100 * len(frame.selection) / num_leaves for frame in frames])
        if scene.tree.num_levels > 1:
            yield row(way, "τ_R px", [frame.selection.pixel_error for frame in frames])

    yield row("leaves in view", "% of leaves", [100 * len(frame.selection) / num_leaves for frame in full])
    thinned = splatree.thin(city, splatree.ThinOptions("pairs", keep=share)).scene
    yield from rows_of("thinned once", thinned, ALL_LEAVES)
    ways = {
        "cut, pairs": splatree.BuildOptions("pairs"),
        "cut, radius": splatree.BuildOptions("radius"),
    }
    if city.mode == "classic":
        ways["cut, pairs, --dilation 0"] = splatree.BuildOptions("pairs", merge=splatree.MergeOptions(dilation=0.0))
    budget = splatree.SelectOptions(budget=int(share * num_leaves))
    for way, options in ways.items():
        yield from rows_of(way, splatree.build_lod(city, options), budget)


if __name__ == "__main__":
    main()
