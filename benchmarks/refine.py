"""What refinement adds to the levels of a scene: PSNR against all leaves, before and after, at equal nodes drawn.

``python benchmarks/refine.py [scene …] [--minutes 1] [--methods pairs radius]``; without a scene, two chunks of the shared city
and two objects; rows of other scenes are kept. Rates were chosen on levels by pairs of 5_1, 5_3 and the biker. Six views from
near to far (benchmarks/quality.py), none of which refinement sees. ``gain`` is the mean over them, ``worst`` the view that gains
least. Rows are selected anew after refinement; the change of their number is printed. Seconds are of the processor.
"""

import argparse
import json
import operator
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, RESULTS, save, table
from quality import Judge

CITY = DATA / "trained" / "semarang_city"
SCENES = (CITY / "5_1", CITY / "5_3", DATA / "formats" / "biker_v4.spz", DATA / "trained" / "playcanvas_logo")


def cuts(num_leaves: int) -> dict[str, st.SelectOptions]:
    """The cuts that are compared."""
    return {
        "10 % of the leaves": st.SelectOptions(budget=num_leaves // 10),
        "5 % of the leaves": st.SelectOptions(budget=num_leaves // 20),
        "3 px": st.SelectOptions(pixel_error=3),
        "6 px": st.SelectOptions(pixel_error=6),
    }


def scores(judge: Judge, scene: st.Scene, select: st.SelectOptions) -> tuple[np.ndarray, float, int]:
    """PSNR of each view, the mean SSIM, and nodes drawn in all of them."""
    found = [st.render(scene, camera, select=select) for camera in judge.cameras]
    values = np.array([min(60.0, judge.psnr(i, result.image)) for i, result in enumerate(found)])
    pairs = zip(found, judge.pictures, strict=True)
    index = np.mean([st.ssim(np.clip(result.image, 0, 1), np.clip(picture, 0, 1)) for result, picture in pairs])
    return values, float(index), sum(result.counters.num_selected for result in found)


def refined(path: Path, method: str, minutes: float) -> list[dict[str, object]]:
    """A row for each cut."""
    leaves = st.read(path)
    tree = st.build_lod(leaves, st.BuildOptions(method))
    judge = Judge(leaves.gaussians, leaves.mode)
    result = st.refine(tree, st.RefineOptions(minutes=minutes))
    rows = []
    for name, select in cuts(leaves.tree.num_leaves).items():
        before, index_before, nodes_before = scores(judge, tree, select)
        after, index_after, nodes_after = scores(judge, result.scene, select)
        rows.append(
            {
                "scene": path.name,
                "levels": method,
                "cut": name,
                "before dB": round(float(before.mean()), 2),
                "after dB": round(float(after.mean()), 2),
                "gain dB": round(float((after - before).mean()), 2),
                "worst dB": round(float((after - before).min()), 2),
                "SSIM": f"{index_before:.4f} → {index_after:.4f}",
                "nodes": f"{nodes_after - nodes_before:+,}",
                "steps": result.iterations,
                "CPU-s": round(result.cpu_seconds, 1),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--methods", nargs="+", default=["pairs", "radius"])
    options = parser.parse_args()
    for path in options.scenes or [scene for scene in SCENES if scene.exists()]:
        for method in options.methods:
            found = refined(path, method, options.minutes)
            print(table(found), flush=True)
            keep(found, options.minutes)


def keep(found: list[dict[str, object]], minutes: float) -> None:
    """Keep the rows of a scene and a method beside those of the others."""
    path, key = RESULTS / "refine.json", operator.itemgetter("scene", "levels")
    kept = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [row for row in kept if key(row) != key(found[0])] + found
    save(
        "refine",
        sorted(rows, key=key),
        about=f"PSNR and SSIM of cuts against all leaves before and after {minutes:g} minutes of refinement, six views that it "
        "does not see, at equal nodes drawn. Rates were chosen on 5_1 and the biker, levels by pairs.",
    )


if __name__ == "__main__":
    main()
