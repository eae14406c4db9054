"""How near thinned scenes and cuts of the tree come to the full scene, from near to far, in the scene's own mode.

``python benchmarks/quality.py [scene] [--mode classic antialiased] [--peer] [--cuts] [--levels radius]
[--dilation 0]``; without a scene, one chunk of the shared city. Six views at growing distance (each twice as far as the one
before) around the median of the scene. Table 1: one thinning to 50, 25, 10 % by pairs and by a radius with
each named rule, and splat-transform's output of the same share with ``--peer`` (npm).
Table 2, for levels by a radius and by pairs: the cut at τ_R = 3 px and more with its share of the leaves over the whole
scene, and the cut that draws at most 10 % of the leaves. All PSNRs are against all leaves, drawn by the
same renderer.
"""

import argparse
import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import get_args

import numpy as np

import splatree
from harness import DATA, RESULTS, save, table
from splatree.metrics.psnr import psnr
from splatree.scene.thinning import Method

CHUNK = DATA / "trained" / "semarang_city" / "5_1"
PEER = "@playcanvas/splat-transform@3.7.0"
DISTANCES = (0.3, 0.6, 1.2, 2.4, 4.8, 9.6)
"""Distances of the views, in radii of the scene (the ball around its median with 80 % of the Gaussians)."""
SHARES = (0.5, 0.25, 0.1)
ALL_LEAVES = splatree.SelectOptions(pixel_error=0)
RULES = {
    "default": splatree.MergeOptions(),
    "mean, union (the scheme's text)": splatree.MergeOptions(rule="mean", weight="opacity", opacity="union"),
    "moments, union": splatree.MergeOptions(weight="opacity", opacity="union"),
    "moments, standard": splatree.MergeOptions(weight="opacity", opacity="standard"),
    "moments, optical": splatree.MergeOptions(weight="opacity-area", opacity="optical"),
}


def views(gaussians: splatree.Gaussians) -> list[splatree.Camera]:
    """Six views from near to far, each from another side and a little steeper."""
    means = gaussians.means.astype(np.float64)
    center = np.median(means, axis=0)
    radius = float(np.quantile(np.linalg.norm(means - center, axis=1), 0.8))
    cameras = []
    for i, distance in enumerate(DISTANCES):
        azimuth, elevation = np.radians(20 + 25 * i), np.radians(30 + 5 * i)
        toward = [np.cos(azimuth) * np.cos(elevation), -np.sin(elevation), np.sin(azimuth) * np.cos(elevation)]
        cameras.append(
            splatree.Camera.look_at(center + radius * distance * np.array(toward), center, width=640, height=480)
        )
    return cameras


class Judge:
    """The full renders, and PSNRs against them."""

    def __init__(self, leaves: splatree.Gaussians, mode: str) -> None:
        self.leaves, self.mode = leaves, mode
        self.cameras = views(leaves)
        full = splatree.Scene.flat(leaves, mode=mode)
        self.pictures = [splatree.render(full, camera, select=ALL_LEAVES).image for camera in self.cameras]

    def flat(self, gaussians: splatree.Gaussians) -> list[float]:
        scene = splatree.Scene.flat(gaussians, mode=self.mode)
        return [self.psnr(i, splatree.render(scene, c, select=ALL_LEAVES).image) for i, c in enumerate(self.cameras)]

    def psnr(self, view: int, image: np.ndarray) -> float:
        return float(psnr(np.clip(image, 0, 1), np.clip(self.pictures[view], 0, 1)))

    def columns(self, values: list[float]) -> dict[str, float]:
        named = {f"view {i + 1}": value for i, value in enumerate(values)}
        return named | {"mean": float(np.mean(values))}


def thinned(judge: Judge, peers: dict[float, splatree.Gaussians]) -> list[dict[str, object]]:
    """Table 1."""
    rows: list[dict[str, object]] = []
    leaves = splatree.Scene.flat(judge.leaves, mode=judge.mode)
    for keep in SHARES:
        pairs = splatree.ThinOptions("pairs", keep=keep)
        unseen = splatree.ThinOptions("pairs", keep=keep, visibility=False)
        entries = {
            "pairs": splatree.thin(leaves, pairs).scene.gaussians,
            "pairs without visibility": splatree.thin(leaves, unseen).scene.gaussians,
        }
        for name, merge in RULES.items():
            color_radius = None if merge.rule == "mean" else splatree.ThinOptions().color_radius
            options = splatree.ThinOptions("radius", keep=keep, merge=merge, color_radius=color_radius)
            entries[f"radius: {name}"] = splatree.thin(leaves, options).scene.gaussians
        if keep in peers:
            entries[f"{PEER} -g cpu -d"] = peers[keep]
        for name, gaussians in entries.items():
            share = len(gaussians) / len(judge.leaves)
            rows.append(
                {"mode": judge.mode, "wanted": keep, "rule": name, "kept": share} | judge.columns(judge.flat(gaussians))
            )
    return rows


def decimated(source: Path, keep: float) -> splatree.Gaussians:
    """The peer's output; it reads the same file."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "out.ply"
        given = source / "meta.json" if source.is_dir() else source
        words = ["npx", "--yes", PEER, "-w", "-g", "cpu", str(given), "-d", f"{100 * keep:g}%", str(target)]
        subprocess.run(words, check=True, capture_output=True)
        return splatree.read(target).gaussians


def cuts(judge: Judge, method: Method, dilation: float | None) -> list[dict[str, object]]:
    """Table 2: a row with PSNRs and a row with shares for each τ_R, and for the budget, of levels made by a method."""
    options = splatree.BuildOptions(method, merge=splatree.MergeOptions(dilation=dilation))
    scene = splatree.build_lod(splatree.Scene.flat(judge.leaves, mode=judge.mode), options)
    num_leaves = len(judge.leaves)
    rows: list[dict[str, object]] = []
    for tau in (2.5, 3.0, 4.0, 6.0):
        options = splatree.SelectOptions(pixel_error=tau)
        everywhere = splatree.SelectOptions(pixel_error=tau, view_test="none")
        quality = [judge.psnr(i, splatree.render(scene, c, select=options).image) for i, c in enumerate(judge.cameras)]
        shares = [100 * len(splatree.select(scene, c, everywhere)) / num_leaves for c in judge.cameras]
        about = {"mode": judge.mode, "levels": method, "cut": f"τ_R = {tau:g} px"}
        rows += [
            about | {"what": "PSNR"} | judge.columns(quality),
            about | {"what": "% of leaves"} | judge.columns(shares),
        ]
    options = splatree.SelectOptions(budget=num_leaves // 10)
    frames = [splatree.trace(scene, camera, select=options) for camera in judge.cameras]
    quality = [judge.psnr(i, frame.result.image) for i, frame in enumerate(frames)]
    about = {"mode": judge.mode, "levels": method, "cut": "budget: 10 % of leaves"}
    rows.append(about | {"what": "PSNR"} | judge.columns(quality))
    rows.append(about | {"what": "τ_R px"} | judge.columns([frame.selection.pixel_error for frame in frames]))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, nargs="?", default=CHUNK)
    parser.add_argument("--mode", nargs="+", choices=("classic", "antialiased"), default=["classic", "antialiased"])
    parser.add_argument("--peer", action="store_true", help="also run splat-transform through npx")
    parser.add_argument("--cuts", action="store_true", help="table 2 alone")
    parser.add_argument(
        "--levels",
        nargs="+",
        choices=get_args(Method),
        default=get_args(Method),
        help="levels of table 2; rows of the others are kept",
    )
    parser.add_argument("--dilation", type=float, help="table 2 alone, for a tree made with this --dilation")
    arguments = parser.parse_args()
    if arguments.peer and shutil.which("npx") is None:
        parser.error("--peer: found no npx, wanted Node with npm")
    scene = splatree.read(arguments.scene)
    leaves = scene.gaussians.take(scene.tree.is_leaf)
    thin_rows: list[dict[str, object]] = []
    cut_rows: list[dict[str, object]] = []
    peers = {keep: decimated(arguments.scene, keep) for keep in SHARES} if arguments.peer else {}
    for mode in arguments.mode:
        judge = Judge(leaves, mode)
        if arguments.dilation is None and not arguments.cuts:
            thin_rows += thinned(judge, peers)
            print(table([row for row in thin_rows if row["mode"] == mode]), end="\n\n", flush=True)
        for method in arguments.levels if arguments.dilation is None else ("radius",):
            cut_rows += cuts(judge, method, arguments.dilation)
        print(table([row for row in cut_rows if row["mode"] == mode]), end="\n\n", flush=True)
    name = arguments.scene.name.split(".")[0]
    if thin_rows:
        save(
            f"quality_thin_{name}",
            thin_rows,
            about="PSNR of one thinning against the full scene, six views near to far",
        )
    if arguments.dilation is not None:
        name += f"_dilation_{arguments.dilation:g}"
    path = RESULTS / f"quality_cut_{name}.json"
    if path.exists() and arguments.dilation is None:
        here = {(row["mode"], row["levels"]) for row in cut_rows}
        kept = json.loads(path.read_text())["rows"]
        cut_rows = [row for row in kept if (row["mode"], row["levels"]) not in here] + cut_rows
    save(f"quality_cut_{name}", cut_rows, about="PSNR of the cut against all leaves, six views near to far")


if __name__ == "__main__":
    main()
