"""What a cut saves at a quality: nodes and frame time of the cut of 40 and of 33 dB against all leaves, at 1080p.

``python benchmarks/pays.py [--scenes ...] [--quality 33 40] [--method radius pairs]`` needs the shared scenes. Levels are built
by each method. In a near, a middle and a far view (levels.py), all leaves and the cut that each quality chooses are drawn,
without and with occlusion (lod/occlusion.py); a time is that of the cheapest of three frames. *frame* is the processor time from
culling to the picture for a τ_R that is known; *chosen* has the search for τ_R in it, from a view alone.
"""

import argparse
from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np

import splatree as st
from harness import save, table
from levels import SCENES, views_of
from splatree.scene.thinning import Method

CLASSES = ("near", "middle", "far")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["city 5_9"])
    parser.add_argument("--quality", nargs="+", type=float, default=[33.0, 40.0])
    parser.add_argument("--method", nargs="+", choices=get_args(Method), default=get_args(Method))
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for name in arguments.scenes:
        read = st.read(SCENES[name])
        flat = st.Scene.flat(read.gaussians.take(read.tree.is_leaf), mode=read.mode)
        views = {key: large(view) for key, view in views_of(flat).items() if key in CLASSES}
        for method in arguments.method:
            with st.open_session(st.build_lod(flat, st.BuildOptions(method))) as session:
                for key, view in views.items():
                    leaves, leaves_s, picture = drawn(session, view, st.SelectOptions(pixel_error=0.0))
                    for quality, occlusion in product(arguments.quality, (False, True)):
                        wanted = st.SelectOptions(quality=quality, occlusion=occlusion)
                        pixel_error = session.select(view, select=wanted).pixel_error
                        by_size = st.SelectOptions(pixel_error=pixel_error, occlusion=occlusion)
                        nodes, cut_s, cut = drawn(session, view, by_size)
                        _, chosen_s, _ = drawn(session, view, wanted)
                        rows.append(
                            {"scene": name, "levels": method, "view": key, "asked, dB": quality, "occlusion": occlusion}
                            | {"PSNR": min(st.psnr(cut, picture), 60.0), "nodes, % of leaves": 100 * nodes / leaves}
                            | {"leaves, CPU ms": 1e3 * leaves_s, "frame, of leaves": cut_s / leaves_s}
                            | {"chosen, of leaves": chosen_s / leaves_s}
                        )
                        print(rows[-1], flush=True)
    print(table(rows))
    kept_as = "pays" if len(arguments.method) > 1 else f"pays_{arguments.method[0]}"
    save(kept_as, rows, about="Nodes and frame time of cuts of a quality against all leaves, 1080p")


def large(view: st.Camera) -> st.Camera:
    """The view at 1920 × 1080 px."""
    K = view.K.copy()
    K[:2] *= 1920 / view.width
    return replace(view, K=K, width=1920, height=1080)


def drawn(session: st.Session, view: st.Camera, select: st.SelectOptions) -> tuple[int, float, np.ndarray]:
    """Nodes, processor seconds of the cheapest of three frames, and what a screen shows."""
    results = [session.draw(view, select=select) for _ in range(3)]
    seconds = min(sum(result.cpu_milliseconds.values()) for result in results) / 1e3
    return results[0].counters.num_selected, seconds, np.clip(results[0].image, 0, 1)


if __name__ == "__main__":
    main()
