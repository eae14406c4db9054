"""Whether pictures have the quality that was asked for: `--quality Q`, and what it costs to find the cut.

``python benchmarks/promise.py [--scenes ...] [--quality 30 35 40]`` needs the shared scenes. Levels by a radius and by pairs are
built. Six views from near to far are drawn by the cut of each quality, and compared with all leaves, pixel by pixel: at 360p,
of which the search sees everything, and at 1080p, of which it sees eight rows of tiles. *moving*: the camera goes on from each
view by a tenth of the distance, and the search begins at the τ_R that was found before.

Where more than 98 % of the leaves are drawn, no coarser cut is as good as asked for: such views keep every promise and are left
out of the mean. So are views in which the coarsest cut there is, 32 px, is better than asked for. PSNRs count to 60 dB at most.
Costs are processor seconds; those of the search are shares of the time that all leaves of the same view take.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

import splatree as st
from harness import DATA, Cost, measure, save, table
from levels import views_of
from splatree.lod.quality import COARSEST_PX
from splatree.scene.thinning import Method

SCENES: dict[str, Path] = {
    "city 5_1": DATA / "trained" / "semarang_city" / "5_1",
    "city 5_9": DATA / "trained" / "semarang_city" / "5_9",
    "playbot": DATA / "trained" / "playbot",
    "logo": DATA / "trained" / "playcanvas_logo",
    "biker": DATA / "formats" / "biker.compressed.ply",
}
STEP = 0.1


def sized(view: st.Camera, height: int) -> st.Camera:
    """The view with 16 : 9 pixels of a height."""
    K = view.K.copy()
    K[:2] *= height / view.height
    return replace(view, K=K, width=height * 16 // 9, height=height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["city 5_9", "playbot", "logo", "biker"])
    parser.add_argument("--method", nargs="+", choices=get_args(Method), default=["radius", "pairs"])
    parser.add_argument("--quality", nargs="+", type=float, default=[30.0, 35.0, 40.0])
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for name in arguments.scenes:
        read = st.read(SCENES[name])
        flat = st.Scene.flat(read.gaussians.take(read.tree.is_leaf), mode=read.mode)
        for method in arguments.method:
            with st.open_session(st.build_lod(flat, st.BuildOptions(method))) as session:
                for height in (360, 1080):
                    views = [sized(view, height) for view in views_of(flat).values()]
                    for cell in judged(session, views, arguments.quality):
                        rows.append({"scene": name, "levels": method, "height, px": height} | cell)
                        print(rows[-1], flush=True)
    print(table(rows))
    save("promise", rows, about="Quality asked for and quality drawn, and the cost of the search")


@dataclass(frozen=True)
class Tried:
    """One view, drawn by the cut of a quality."""

    beyond: float
    """By how much it is better than asked for, dB."""
    drawn: float
    """Share of the leaves that are drawn."""
    pixel_error: float
    """τ_R that was found, px."""
    cost: float
    """Processor time of the search, of that of drawing all leaves."""


def judged(session: st.Session, views: list[st.Camera], qualities: list[float]) -> list[dict[str, object]]:
    """A line for each quality, of a view alone and of a camera that moves on."""
    found: dict[tuple[bool, float], list[Tried]] = {}
    for view in views:
        leaves = drawn_leaves(session, view)
        shown = leaves.value
        distance = float(np.median(shown.depth[shown.alpha > 0.5]))
        pose = view.camera_from_world.copy()
        pose[2, 3] -= STEP * distance
        ahead = replace(view, camera_from_world=pose)
        of_ahead = drawn_leaves(session, ahead)
        for quality in qualities:
            session.select(
                view.scaled(0.1), select=st.SelectOptions(quality=quality)
            )  # forget what is known of this view
            alone = tried(session, view, leaves, quality, None)
            found.setdefault((False, quality), []).append(alone)
            found.setdefault((True, quality), []).append(tried(session, ahead, of_ahead, quality, alone.pixel_error))
    return [
        {"moving": moving, "asked, dB": quality} | summary(each) for (moving, quality), each in sorted(found.items())
    ]


def drawn_leaves(session: st.Session, view: st.Camera) -> Cost:
    """The picture of all leaves and its cost."""
    return measure(lambda: session.draw(view, select=st.SelectOptions(pixel_error=0.0)), repeat=2)


def tried(session: st.Session, view: st.Camera, leaves: Cost, quality: float, last: float | None) -> Tried:
    search = measure(lambda: session.select(view, select=st.SelectOptions(quality=quality), last=last))
    pixel_error = search.value.pixel_error
    cut = session.draw(view, select=st.SelectOptions(pixel_error=pixel_error))
    psnr = st.psnr(np.clip(cut.image, 0, 1), np.clip(leaves.value.image, 0, 1))
    share = len(search.value) / leaves.value.counters.num_selected
    return Tried(min(psnr, 60.0) - quality, share, pixel_error, search.cpu_s / leaves.cpu_s)


def summary(views: list[Tried]) -> dict[str, object]:
    """By how much the pictures are better than asked for, and what the search costs."""
    exact = sum(view.drawn > 0.98 for view in views)
    coarsest = sum(view.pixel_error >= COARSEST_PX and view.beyond > 0 for view in views)
    spare = [
        view.beyond
        for view in views
        if view.drawn <= 0.98 and not (view.pixel_error >= COARSEST_PX and view.beyond > 0)
    ]
    return {
        "mean": float(np.mean(spare)) if spare else "",
        "worst": min(spare) if spare else "",
        "best": max(spare) if spare else "",
        "views": len(views),
        "of all leaves": exact,
        "of the coarsest cut": coarsest,
        "nodes, % of leaves": 100 * float(np.mean([view.drawn for view in views])),
        "search, of leaves": float(np.mean([view.cost for view in views])),
    }


if __name__ == "__main__":
    main()
