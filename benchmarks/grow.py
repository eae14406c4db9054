"""Levels that are merged and refined after training, beside a tree that grows while it learns, as FilterGS and LoG make theirs.

``python benchmarks/grow.py [plush drone] [--seconds 60]``; rows of other photographs are kept. Both train on the same photographs
with the same processor seconds and the same number of leaves at most, and both are refined then. The pictures are held-out
photographs, at the size of training and at a quarter of it, with a gain for each channel fitted on the left half and scored on
the right half. Both draw the same number of nodes: that of the grown tree's own cut at the given τ_R, which the published
selection (R = 3σ) makes; ours is chosen by a budget, view by view.
"""

import argparse
import json
from collections.abc import Iterator
from functools import partial

import numpy as np

import splatree as st
from harness import DATA, RESULTS, measure, save, table
from splatree.io.cameras.split import split_views
from splatree.metrics.gain import psnr_with_gain
from splatree.train.targets import Target, Targets

PHOTOGRAPHS = {"plush": ("snowmiku_plush_small", 50_000), "drone": ("caliterra_drone", 120_000)}

CUTS = (0.0, 3.0, 6.0, 12.0, 24.0)
"""τ_R of the grown tree's cuts, px; each gives the number of nodes that is drawn of every tree. At 0 all leaves are."""

REFINED_MIN = 0.25
"""Processor minutes of refinement."""


def held_out(folder: str, division: int) -> Iterator[Target]:
    """The held-out photographs with their cameras at a division."""
    path = DATA / "images" / folder
    targets = Targets(path, split_views(st.read_cameras(path).views, 8).held_out)
    for i in range(len(targets)):
        yield targets.at(i, division)


def score(scene: st.Scene, targets: list[Target], selects: list[st.SelectOptions]) -> tuple[float, float]:
    """Mean PSNR with its gain fitted, dB, and mean nodes drawn."""
    found = []
    for target, select in zip(targets, selects, strict=True):
        drawn = st.render(scene, placed(scene, target), select=select)
        found.append((psnr_with_gain(drawn.image, target.photo / np.float32(255)), drawn.counters.num_selected))
    psnr, nodes = np.mean(found, axis=0)
    return float(psnr), float(nodes)


def placed(scene: st.Scene, target: Target) -> st.Camera:
    """The view of a target in the world of a trained scene."""
    return st.Cameras((target.camera,)).relative_to(scene.source).views[0]


def rows_of(name: str, seconds: float) -> list[dict[str, object]]:
    """Each cut of each tree."""
    folder, count = PHOTOGRAPHS[name]
    trees, costs = {}, {}
    for label, levels in (("train, build", "pairs"), ("grow", "grow")):
        options = st.TrainOptions(minutes=seconds / 60, max_gaussians=count, levels=levels, score=False)
        trained = measure(partial(st.train, DATA / "images" / folder, options, threads=1))
        tree = trained.value.scene
        refined = measure(partial(st.refine, tree, st.RefineOptions(minutes=REFINED_MIN), threads=1))
        trees |= {label: tree, f"{label}, refine": refined.value.scene}
        costs |= {label: trained.cpu_s, f"{label}, refine": trained.cpu_s + refined.cpu_s}
    return [row for division in (2, 8) for row in _compared(name, trees, costs, list(held_out(folder, division)))]


def _compared(
    name: str, trees: dict[str, st.Scene], costs: dict[str, float], targets: list[Target]
) -> Iterator[dict[str, object]]:
    size = f"{targets[0].camera.width} × {targets[0].camera.height}"
    for tau in CUTS:
        grown, own = trees["grow"], [st.SelectOptions(pixel_error=tau)] * len(targets)
        budgets = own
        if tau:
            found = [len(st.select(grown, placed(grown, target), own[0]).rows) for target in targets]
            budgets = [st.SelectOptions(pixel_error=0, budget=max(1, count)) for count in found]
        for label, scene in trees.items():
            psnr, nodes = score(scene, targets, own if label.startswith("grow") else budgets)
            yield {
                "photographs": name,
                "size": size,
                "cut": f"{tau:g} px of the grown tree" if tau else "all leaves",
                "levels": label,
                "nodes drawn": round(nodes),
                "PSNR": psnr,
                "leaves": scene.tree.num_leaves,
                "roots": int((scene.tree.depth == 0).sum()),
                "CPU s": costs[label],
            }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", nargs="*", choices=[*PHOTOGRAPHS, []])
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    chosen, path = options.photographs or list(PHOTOGRAPHS), RESULTS / "grow.json"
    kept = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [row for row in kept if row["photographs"] not in chosen]
    for name in chosen:
        rows += rows_of(name, options.seconds)
        print(table(rows), flush=True)
    save(
        "grow",
        rows,
        about="Held-out photographs at two sizes, PSNR with a gain fitted on the left half and scored on the right half, at "
        "equal nodes drawn: merged levels after training, and a tree that grew in training, as they are and refined.",
    )


if __name__ == "__main__":
    main()
