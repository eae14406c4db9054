"""What drawing hidden nodes more coarsely is worth: cuts with and without occlusion, at equal nodes.

``python benchmarks/occlusion.py [--scenes ...] [--method pairs] [--shares 2 5 10 20 40]`` needs the shared scenes. Six views of
each scene (levels.py) at 960 × 540 px. A budget is a share of the leaves in view. Both pictures are compared with that of all
leaves; better ones than 60 dB count as that. Milliseconds are of the processor, for the selection of a view alone, the cheaper of
two.

``--limit 40`` asks instead what could be saved at that PSNR, at 1920 × 1080 px, by one who knows the picture. Of all leaves, and
of the cut of each of ``--cut-quality`` with occlusion, those are left out that show the least in the view itself: the sum over
the tiles of a node of (Σ α T)². The number that is left out is found by halving. What nodes show is also taken from a picture of
half the size.

``--pixel-error 2 4 8`` asks instead whether a τ_R means the same with occlusion as without: both cuts of each τ_R, their PSNR
and their nodes.
"""

import argparse
import time
from dataclasses import replace
from typing import get_args

import numpy as np

import splatree as st
from harness import save, table
from levels import BEST_DB, SCENES, views_of
from pays import large
from splatree.scene.frame import Selection
from splatree.scene.thinning import Method


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["city 5_9", "city 5_3", "playbot", "biker"])
    parser.add_argument("--method", choices=get_args(Method), default="pairs")
    parser.add_argument("--shares", nargs="+", type=float, default=[2, 5, 10, 20, 40])
    parser.add_argument("--pixel-error", nargs="+", type=float, default=[])
    parser.add_argument("--limit", type=float)
    parser.add_argument("--cut-quality", nargs="+", type=float, default=[40.5, 42, 44])
    parser.add_argument("--views", nargs="+", default=["near", "low", "street", "middle", "orbit", "far"])
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for name in arguments.scenes:
        read = st.read(SCENES[name])
        flat = st.Scene.flat(read.gaussians.take(read.tree.is_leaf).with_sh_degree(0), mode=read.mode)
        views = {key: view for key, view in views_of(flat).items() if key in arguments.views}
        views = {key: large(view) if arguments.limit else view.resized(960, 540) for key, view in views.items()}
        with st.open_session(st.build_lod(flat, st.BuildOptions(arguments.method))) as session:
            for key, view in views.items():
                what: dict[str, object] = {"scene": name, "view": key}
                if arguments.limit:
                    rows += limits(session, view, arguments.limit, arguments.cut_quality, what)
                elif arguments.pixel_error:
                    rows += by_size(session, view, arguments.pixel_error, what)
                else:
                    rows += of_view(session, view, arguments.shares, what)
    print(table(rows))
    if arguments.limit:
        save("occlusion_limit", rows, about="Nodes at a PSNR if those are left out that show least in the view itself")
        return
    if arguments.pixel_error:
        print(table(means(rows)))
        save("occlusion_meaning", rows, about="Cuts of a τ_R with occlusion and without")
        return
    gains = np.array([row["gain, dB"] for row in rows])
    print(
        f"mean {gains.mean():+.2f} dB, worst {gains.min():+.2f}, cells that lose {int((gains < -0.05).sum())} of {len(gains)}"
    )
    save(
        "occlusion", rows, about="Cuts that draw hidden nodes more coarsely, against cuts of as many nodes that do not"
    )


def of_view(
    session: st.Session, view: st.Camera, shares: list[float], what: dict[str, object]
) -> list[dict[str, object]]:
    """A row for each share."""
    truth, num_leaves = all_leaves(session, view)
    rows = []
    for share in shares:
        row: dict[str, object] = what | {"share, %": share, "nodes": max(1, int(num_leaves * share / 100))}
        decibels = []
        for name, occlusion in (("plain", False), ("occlusion", True)):
            options = st.SelectOptions(pixel_error=0, budget=row["nodes"], occlusion=occlusion)
            found, milliseconds = selected(session.scene, view, options)
            picture = session.draw(view, select=lambda view, threads=0, found=found: found).image
            decibels.append(min(st.psnr(np.clip(picture, 0, 1), truth), BEST_DB))
            row |= {f"{name}, dB": decibels[-1], f"{name}, CPU ms": milliseconds}
        rows.append(row | {"gain, dB": decibels[1] - decibels[0]})
        print(rows[-1], flush=True)
    return rows


def by_size(
    session: st.Session, view: st.Camera, pixel_errors: list[float], what: dict[str, object]
) -> list[dict[str, object]]:
    """A row for each τ_R."""
    truth, num_leaves = all_leaves(session, view)
    rows = []
    for pixel_error in pixel_errors:
        row: dict[str, object] = what | {"τ_R, px": pixel_error}
        for name, occlusion in (("plain", False), ("occlusion", True)):
            drawn = session.draw(view, select=st.SelectOptions(pixel_error, occlusion=occlusion))
            row[f"{name}, dB"] = min(st.psnr(np.clip(drawn.image, 0, 1), truth), BEST_DB)
            row[f"{name}, % of leaves"] = 100 * drawn.counters.num_selected / num_leaves
        rows.append(row)
        print(rows[-1], flush=True)
    return rows


def limits(
    session: st.Session, view: st.Camera, wanted: float, qualities: list[float], what: dict[str, object]
) -> list[dict[str, object]]:
    """A row for all leaves, for the cut of the PSNR itself, and for finer ones: nodes before and after some are left out."""
    truth, num_leaves = all_leaves(session, view)
    cuts = {"leaves": st.SelectOptions(pixel_error=0)}
    cuts |= {
        f"cut of {quality:g} dB": st.SelectOptions(quality=quality, occlusion=True) for quality in [wanted, *qualities]
    }
    rows = []
    for name, select in cuts.items():
        found = session.select(view, select=select)
        row = what | {"of": name, "nodes, % of leaves": 100 * len(found) / num_leaves}
        for size in (1.0, 0.5):
            frame = session.trace(
                view.scaled(size), st.Wanted(contributions=True), select=lambda view, threads=0, found=found: found
            )
            per_pair = frame.contributions.astype(np.float64)
            shown = np.bincount(frame.bins.splat_from_pair, per_pair**2, len(frame.splats))
            by_light = frame.splats.rows[np.argsort(shown)]
            by_light = np.concatenate(
                [np.setdiff1d(found.rows, by_light), by_light]
            )  # without a splat they show nothing

            def psnr(num_left_out: int, found: Selection = found, by_light: np.ndarray = by_light) -> float:
                left = replace(found, rows=np.sort(by_light[num_left_out:]))
                image = session.draw(view, select=lambda view, threads=0: left).image
                return min(st.psnr(np.clip(image, 0, 1), truth), BEST_DB)

            fewest, most = 0, len(by_light)
            while most - fewest > max(1, num_leaves // 500):
                middle = (fewest + most) // 2
                fewest, most = (middle, most) if psnr(middle) >= wanted else (fewest, middle)
            row |= {"dB": psnr(0), f"left by a picture of size {size:g}": 100 * (len(by_light) - fewest) / num_leaves}
        rows.append(row)
        print(rows[-1], flush=True)
    return rows


def all_leaves(session: st.Session, view: st.Camera) -> tuple[np.ndarray, int]:
    """Their picture, and how many are in view."""
    drawn = session.draw(view, select=st.SelectOptions(pixel_error=0))
    return np.clip(drawn.image, 0, 1), drawn.counters.num_selected


def means(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """A row for each τ_R, the mean of the views."""
    lines = []
    for pixel_error in dict.fromkeys(row["τ_R, px"] for row in rows):
        of = [row for row in rows if row["τ_R, px"] == pixel_error]
        keys = [key for key in of[0] if "dB" in key or "%" in key]
        lines.append({"τ_R, px": pixel_error} | {key: float(np.mean([row[key] for row in of])) for key in keys})
    return lines


def selected(scene: st.Scene, view: st.Camera, options: st.SelectOptions) -> tuple[Selection, float]:
    """The selection, and what it takes."""
    costs = []
    for _ in range(2):
        start = time.process_time()
        found = st.select(scene, view, options)
        costs.append(1e3 * (time.process_time() - start))
    return found, min(costs)


if __name__ == "__main__":
    main()
