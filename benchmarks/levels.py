"""Cuts of our levels against static sets, at equal visible nodes: the table that finds where levels lose.

``python benchmarks/levels.py [--scenes ...] [--shares 2 5 10 20 40 80] [--peer-shares 10 40] [--levels radius]`` needs the shared
scenes, or takes files; rows of other scenes are kept. A scene is thinned by pairs to a share of its Gaussians, and by
splat-transform's ``-d`` to each of the peer's shares (npm). In each view a thinned scene draws as many of its rows as are in
view; the cuts of levels by a radius and by pairs get this number as their budget. All pictures are compared with that of all
leaves; better ones than 60 dB count as that. Views are of six classes: near, low, street, middle, orbit, far. With ``--levels``
of one method, static sets and the column of the other method are those of the kept rows.

A cut that depends on the view should never be worse than a static set of as many Gaussians: a negative number is a loss.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np

import splatree as st
from harness import DATA, RESULTS, save, table
from quality import decimated
from splatree.errors import InputError
from splatree.scene.thinning import Method

SCENES: dict[str, Path] = {
    "city 5_9": DATA / "trained" / "semarang_city" / "5_9",
    "city 5_1": DATA / "trained" / "semarang_city" / "5_1",
    "city 5_3": DATA / "trained" / "semarang_city" / "5_3",
    "biker": DATA / "formats" / "biker.compressed.ply",
    "playbot": DATA / "trained" / "playbot",
    "logo": DATA / "trained" / "playcanvas_logo",
    "block": DATA / "formats" / "semarang_block" / "block_inria.ply",
}
PEER = "splat-transform -d"
BEST_DB = 60.0


def views_of(scene: st.Scene) -> dict[str, st.Camera]:
    """One view of each class."""

    def view(elevation: float, distance: float) -> st.Camera:
        options = st.PathOptions(views=1, width=480, height=270, elevation_deg=elevation)
        return st.flyout(scene, options, nearest=distance, farthest=distance)[0]

    return {
        "near": view(30, 0.4),
        "low": view(10, 0.8),
        "street": view(3, 0.35),
        "middle": view(30, 1.5),
        "orbit": st.orbit(scene, st.PathOptions(views=1, width=480, height=270))[0],
        "far": view(30, 5.0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["city 5_9", "biker"], help=f"files, or of {', '.join(SCENES)}")
    parser.add_argument("--shares", nargs="+", type=float, default=[2, 5, 10, 20, 40, 80])
    parser.add_argument(
        "--peer-shares", nargs="*", type=float, default=[], help="run splat-transform to these shares too"
    )
    parser.add_argument(
        "--levels",
        nargs="+",
        choices=get_args(Method),
        default=get_args(Method),
        help="levels that are measured; of one method alone, all else is as it was kept",
    )
    arguments = parser.parse_args()
    path = RESULTS / "levels.json"
    kept: list[dict[str, object]] = json.loads(path.read_text())["rows"] if path.exists() else []
    rows: list[dict[str, object]] = []
    for name in arguments.scenes:
        read = st.read(SCENES.get(name) or name)
        flat = st.Scene.flat(read.gaussians.take(read.tree.is_leaf), mode=read.mode)
        trees = {method: st.build_lod(flat, st.BuildOptions(method)) for method in arguments.levels}
        views = views_of(flat)
        leaves = {key: picture(flat, view, None)[0] for key, view in views.items()}
        cells = [row for row in kept if row["scene"] == Path(name).stem]
        if len(trees) == len(get_args(Method)):
            cells = list(cells_of(name, flat, views, leaves, arguments.shares, arguments.peer_shares))
        for row in cells:
            key, budget, found = str(row["view"]), int(row["visible nodes"]), float(row["static, dB"])  # type: ignore[call-overload,arg-type]
            for method, tree in trees.items():
                try:
                    cut, _ = picture(tree, views[key], budget)
                except InputError:  # more roots are in view than the static set shows rows
                    row[f"cut, {method}, dB"] = row[f"{method} − static"] = ""
                    continue
                psnr = min(st.psnr(cut, leaves[key]), BEST_DB)
                row |= {f"cut, {method}, dB": psnr, f"{method} − static": psnr - found}
            rows.append(row)
            print(row, flush=True)
    print(table(rows))
    print(table(summary(rows)))
    here = {row["scene"] for row in rows}
    rows = [row for row in kept if row["scene"] not in here] + rows
    save("levels", rows, about="Cuts of our levels against static sets of as many visible nodes")


def cells_of(
    name: str,
    flat: st.Scene,
    views: dict[str, st.Camera],
    leaves: dict[str, np.ndarray],
    shares: list[float],
    peer_shares: list[float],
) -> Iterator[dict[str, object]]:
    """A row for each static set and view: what the static set shows."""
    for kind, share, static in statics(flat, shares, peer_shares):
        for key, view in views.items():
            image, budget = picture(static, view, None)
            found = min(st.psnr(image, leaves[key]), BEST_DB)
            row: dict[str, object] = {"scene": Path(name).stem, "static set": kind, "share, %": share, "view": key}
            yield row | {"visible nodes": budget, "static, dB": found}


def statics(flat: st.Scene, shares: list[float], peer_shares: list[float]) -> Iterator[tuple[str, float, st.Scene]]:
    """Static sets of a scene: who made each, its share in %, and its Gaussians."""
    for share in shares:
        yield "thin, pairs", share, st.thin(flat, st.ThinOptions("pairs", keep=share / 100)).scene
    if not peer_shares:
        return
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "leaves.ply"
        st.write(flat, source)
        for share in peer_shares:
            yield PEER, share, st.Scene.flat(decimated(source, share / 100), mode=flat.mode)


def picture(scene: st.Scene, view: st.Camera, budget: int | None) -> tuple[np.ndarray, int]:
    """What a screen shows of all leaves in view, or of the cut within a budget; and how many nodes that are."""
    select = st.SelectOptions(pixel_error=0.0, budget=budget)
    result = st.render(scene, view, select=select)
    return np.clip(result.image, 0, 1), result.counters.num_selected


def summary(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """Mean and worst difference by scene, static set and method."""
    lines: list[dict[str, object]] = []
    for name, kind in dict.fromkeys((row["scene"], row["static set"]) for row in rows):
        for method in get_args(Method):
            key = f"{method} − static"
            of = [row for row in rows if (row["scene"], row["static set"]) == (name, kind) and row[key] != ""]
            spare = [float(row[key]) for row in of]  # type: ignore[arg-type]
            worst = of[int(np.argmin(spare))]
            lines.append(
                {
                    "scene": name,
                    "static set": kind,
                    "levels": method,
                    "mean": float(np.mean(spare)),
                    "worst": min(spare),
                }
                | {"worst at": f"{worst['share, %']:g} %, {worst['view']}", "losses": sum(x < 0 for x in spare)}
                | {"cells": len(spare)}
            )
    return lines


if __name__ == "__main__":
    main()
