"""Cuts of our levels against our own static `thin`, at equal visible nodes: the table that finds where levels lose.

``python benchmarks/levels.py [--scenes ...] [--shares 2 5 10 20 40 80]`` needs the shared scenes. A scene is thinned by pairs to
a share of its Gaussians. In each view the thinned scene draws as many of its rows as are in view; the cuts of levels by a radius
and by pairs get this number as their budget. All pictures are compared with that of all leaves. Views are of six classes: near,
low, street, middle, orbit, far.

A cut that depends on the view should never be worse than a static set of as many Gaussians: a negative number is a loss. Levels
of other programs are not part of this table; `benchmarks/streams.py` compares with theirs.
"""

import argparse
from pathlib import Path
from typing import get_args

import numpy as np

import splatree as st
from harness import DATA, save, table
from splatree.errors import InputError
from splatree.scene.thinning import Method

SCENES: dict[str, Path] = {
    "city 5_9": DATA / "trained" / "semarang_city" / "5_9",
    "city 5_1": DATA / "trained" / "semarang_city" / "5_1",
    "biker": DATA / "formats" / "biker.compressed.ply",
    "playbot": DATA / "trained" / "playbot",
}


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
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["city 5_9", "biker"])
    parser.add_argument("--shares", nargs="+", type=float, default=[2, 5, 10, 20, 40, 80])
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for name in arguments.scenes:
        read = st.read(SCENES[name])
        flat = st.Scene.flat(read.gaussians.take(read.tree.is_leaf), mode=read.mode)
        trees = {method: st.build_lod(flat, st.BuildOptions(method)) for method in get_args(Method)}
        views = views_of(flat)
        leaves = {key: picture(flat, view, None)[0] for key, view in views.items()}
        for share in arguments.shares:
            thinned = st.thin(flat, st.ThinOptions("pairs", keep=share / 100)).scene
            for key, view in views.items():
                static, budget = picture(thinned, view, None)
                row: dict[str, object] = {"scene": name, "share, %": share, "view": key, "visible nodes": budget}
                row["thin, pairs, dB"] = st.psnr(static, leaves[key])
                for method, tree in trees.items():
                    try:
                        cut, _ = picture(tree, view, budget)
                    except InputError:  # more roots are in view than the static set shows rows
                        row[f"cut, {method}, dB"] = row[f"{method} − thin"] = ""
                        continue
                    row[f"cut, {method}, dB"] = min(st.psnr(cut, leaves[key]), 60.0)
                    row[f"{method} − thin"] = row[f"cut, {method}, dB"] - row["thin, pairs, dB"]  # type: ignore[operator]
                rows.append(row)
                print(row, flush=True)
    print(table(rows))
    print(table(summary(rows)))
    save("levels", rows, about="Cuts of our levels against our own static thinning by pairs, at equal visible nodes")


def picture(scene: st.Scene, view: st.Camera, budget: int | None) -> tuple[np.ndarray, int]:
    """What a screen shows of all leaves in view, or of the cut within a budget; and how many nodes that are."""
    select = st.SelectOptions(pixel_error=0.0, budget=budget)
    result = st.render(scene, view, select=select)
    return np.clip(result.image, 0, 1), result.counters.num_selected


def summary(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """Mean and worst difference by scene and method."""
    lines: list[dict[str, object]] = []
    for name in dict.fromkeys(row["scene"] for row in rows):
        for method in get_args(Method):
            of = [row for row in rows if row["scene"] == name and row[f"{method} − thin"] != ""]
            spare = [float(row[f"{method} − thin"]) for row in of]  # type: ignore[arg-type]
            worst = of[int(np.argmin(spare))]
            lines.append(
                {"scene": name, "levels": method, "mean": float(np.mean(spare)), "worst": min(spare)}
                | {"worst at": f"{worst['share, %']:g} %, {worst['view']}", "losses": sum(x < 0 for x in spare)}
                | {"cells": len(spare)}
            )
    return lines


if __name__ == "__main__":
    main()
