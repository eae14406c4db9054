"""Pops of each frame at a quality, and what hysteresis would change: refine a node at 1.25 τ, merge its children at τ.

``python benchmarks/popping.py [--scenes ...] [--method pairs] [--quality 40]`` needs the shared scenes. τ_R is measured in
the first frame and kept. From three views the camera moves ahead and back by a hundredth of the distance a frame, and to and
fro between two frames. Each frame is drawn by its own cut and by the one before (render/popping.py). With hysteresis a
frame's cut is the one before, held between the cut of τ and that of 1.25 τ on every path from a root to a leaf, which is an
exact cut again. *after a quarter*: nodes and PSNR against all leaves after the camera has moved by a quarter of the distance.

With ``--occlusion`` all cuts draw hidden nodes more coarsely, without hysteresis: cuts of τ and 1.25 τ are not nested then.
"""

import argparse
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import get_args

import numpy as np

import splatree as st
from harness import save, table
from promise import SCENES
from splatree.scene.frame import Selection
from splatree.scene.thinning import Method
from splatree.scene.view import View

BAND = 1.25
FRAMES, STEP = 7, 0.01
LONG_FRAMES, LONG_STEP = 8, 0.035


@dataclass(frozen=True)
class Fixed:
    """A selector that draws one cut in any view."""

    cut: Selection

    def __call__(self, view: View, *, threads: int = 0) -> Selection:
        return self.cut


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["city 5_9", "logo", "biker"])
    parser.add_argument("--method", nargs="+", choices=get_args(Method), default=get_args(Method))
    parser.add_argument("--quality", type=float, default=40.0)
    parser.add_argument("--occlusion", action="store_true")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for name in arguments.scenes:
        read = st.read(SCENES[name])
        flat = st.Scene.flat(read.gaussians.take(read.tree.is_leaf), mode=read.mode)
        views = st.flyout(flat, st.PathOptions(views=3, width=480, height=270))
        for method in arguments.method:
            with st.open_session(st.build_lod(flat, st.BuildOptions(method))) as session:
                for key, view in zip(("near", "middle", "far"), views, strict=True):
                    for row in of_view(session, flat, view, arguments.quality, arguments.occlusion):
                        rows.append({"scene": name, "levels": method, "view": key} | row)
                        print(rows[-1], flush=True)
    print(table(rows))
    if arguments.occlusion:
        save("popping_occlusion", rows, about="Pops of slow dollies at a quality, with occlusion")
    else:
        save("popping", rows, about="Pops of slow dollies at a quality, without and with hysteresis")


def of_view(
    session: st.Session, flat: st.Scene, view: st.Camera, quality: float, occlusion: bool
) -> list[dict[str, object]]:
    """A line for each path, without and with hysteresis."""
    wanted = st.SelectOptions(quality=quality, occlusion=occlusion)
    pixel_error = session.select(view, select=wanted).pixel_error
    if pixel_error == 0:
        return []
    drawn = [session.select(view, select=st.SelectOptions(tau, occlusion=occlusion)) for tau in (pixel_error, 0.0)]
    ahead, back = (list(st.dolly(flat, view, FRAMES, step=step)) for step in (STEP, -STEP))
    quarter = list(st.dolly(flat, view, LONG_FRAMES, step=LONG_STEP))
    lines: list[dict[str, object]] = []
    for name, path in {"ahead": ahead, "back": back, "to and fro": [*ahead[:2]] * 2}.items():
        for holds in (False,) if occlusion else (False, True):
            cuts = cuts_of(session, path, pixel_error, holds, occlusion)
            pops = [pop(session, camera, *two) for camera, two in zip(path[1:], pairwise(cuts), strict=True)]
            at_end = cuts_of(session, quarter, pixel_error, holds, occlusion)[-1]
            lines.append(
                {"path": name, "hysteresis": holds, "τ_R, px": pixel_error}
                | {"nodes, % of leaves": 100 * len(drawn[0]) / len(drawn[1])}
                | {"worst frame, dB": min(db for db, _ in pops), "worst tile": max(tile for _, tile in pops)}
                | {"switched a frame": float(np.mean([len(np.setdiff1d(b, a)) for a, b in pairwise(cuts)]))}
                | {"nodes after a quarter": len(at_end), "dB after a quarter": psnr_of(session, quarter[-1], at_end)}
            )
    return lines


def cuts_of(
    session: st.Session, path: list[st.Camera], pixel_error: float, holds: bool, occlusion: bool
) -> list[np.ndarray]:
    """The rows of each frame's cut, in view or not."""

    def whole(camera: st.Camera, tau: float) -> np.ndarray:
        whole = st.SelectOptions(tau, view_test="none", cull="none", occlusion=occlusion)
        return session.select(camera, select=whole).rows

    cuts = [whole(path[0], pixel_error)]
    for camera in path[1:]:
        fine = whole(camera, pixel_error)
        cuts.append(held(session, cuts[-1], fine, whole(camera, BAND * pixel_error)) if holds else fine)
    return cuts


def held(session: st.Session, before: np.ndarray, fine: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """The cut ``before``, held between a fine and a coarse one on each path from a root to a leaf."""
    end = session.scene.tree.subtree_end

    def above(cut: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The node of a cut that each row lies below or is; −1 where there is none."""
        node = cut[np.maximum(np.searchsorted(cut, rows, "right") - 1, 0)]
        return np.where((node <= rows) & (rows < end[node]), node, -1)

    old, coarsest = above(before, fine), above(coarse, fine)
    is_coarser = (old >= 0) & (old < fine)  # preorder: an ancestor has the smaller row
    return np.unique(np.where(is_coarser, np.maximum(old, coarsest), fine))


def picture(session: st.Session, camera: st.Camera, rows: np.ndarray) -> np.ndarray:
    chosen = replace(session.select(camera, select=st.SelectOptions(pixel_error=0.0)), rows=rows.astype(np.int32))
    return np.clip(session.draw(camera, select=Fixed(chosen)).image, 0, 1)


def psnr_of(session: st.Session, camera: st.Camera, rows: np.ndarray) -> float:
    """PSNR of a cut against all leaves, dB."""
    leaves = np.clip(session.draw(camera, select=st.SelectOptions(pixel_error=0.0)).image, 0, 1)
    return min(st.psnr(picture(session, camera, rows), leaves), 100.0)


def pop(session: st.Session, camera: st.Camera, before: np.ndarray, own: np.ndarray) -> tuple[float, float]:
    """PSNR of the two cuts' pictures, dB, and the largest mean change of a tile."""
    if np.array_equal(own, before):
        return 100.0, 0.0
    one, other = (picture(session, camera, rows).astype(np.float64) for rows in (own, before))
    change = np.abs(one - other).mean(axis=2)
    height, width = (16 * (size // 16) for size in change.shape)
    tiles = change[:height, :width].reshape(height // 16, 16, width // 16, 16).mean(axis=(1, 3))
    return min(st.psnr(one, other), 100.0), float(tiles.max())


if __name__ == "__main__":
    main()
