"""What the error on held-out photographs is made of: how much PSNR a cause takes, found by taking the cause away.

``python benchmarks/train_errors.py NAME SCENE.splatree PHOTOGRAPHS`` draws the held-out views, and some training views, of a
scene that ``splatree train`` left. Each column takes one cause away from each picture, with its photograph at hand: these are
bounds, not results. No training reaches a bound that needs another camera or another photograph. What training photographs gain
alike is no reason why held-out ones are drawn worse.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import harness
import splatree as st
from splatree.train.targets import Target, Targets

ABOUT = """PSNR of pictures with a gain for each channel fitted on the whole picture, mean over the pictures, dB; how much more
when one cause of the error is taken away from each picture with its photograph at hand; and which share of the squared error is
coarser than 32 px.""".replace("\n", " ")

TILE_PX = 64
"""Tiles that are moved, or brightened, each by itself."""

EVERY, HELD_OUT = 12, 8
"""Each n-th training photograph; each n-th photograph is held out."""

POSE_STEP = 2e-4
"""Turn, rad, and move, in depths of the scene, by which pictures are differentiated."""

POSE_ROUNDS = 2
"""Steps of Gauss and Newton towards the pose that fits best."""

BLURS_PX = (0.4, 0.8)
"""σ of the blurs."""

COARSE_PX = 32
"""Errors that are larger than this are no detail."""


@dataclass(frozen=True)
class Pair:
    """A picture and its photograph."""

    image: np.ndarray
    """As drawn, [h w 3]."""
    photo: np.ndarray
    """0 to 1, [h w 3]."""

    def psnr(self, image: np.ndarray | None = None) -> float:
        """PSNR of a picture instead of this one, dB."""
        image = self.image if image is None else image
        return float(-10 * np.log10(np.square(np.clip(fitted(image, self.photo), 0, 1) - self.photo).mean()))


def fitted(image: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """A picture with the gain of each channel that brings it nearest to a photograph."""
    return image * ((image * photo).sum((0, 1)) / np.maximum(np.square(image).sum((0, 1)), 1e-12))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="of the row in the results")
    parser.add_argument("scene", type=Path)
    parser.add_argument("photographs", type=Path)
    options = parser.parse_args()
    scene = st.read(options.scene)
    rows = [{"scene": options.name, **row} for row in measured(scene, options.photographs)]
    print(harness.table(rows))
    path = harness.RESULTS / "train_errors.json"
    kept = json.loads(path.read_text())["rows"] if path.exists() else []
    harness.save("train_errors", [*(row for row in kept if row["scene"] != options.name), *rows], about=ABOUT)


def measured(scene: st.Scene, folder: Path) -> list[dict[str, Any]]:
    """A row for held-out photographs, and one for training ones."""
    views = list(st.read_cameras(folder))
    chosen = {"held out": views[::HELD_OUT], "training": [v for i, v in enumerate(views) if i % HELD_OUT][::EVERY]}
    rows = []
    for label, cameras in chosen.items():
        targets = list(pictures(scene, folder, cameras))
        found = [causes(scene, target) for target in targets]
        base = [one.pop("PSNR") for one in found]
        more = {key: float(np.mean([one[key] - b for one, b in zip(found, base, strict=True)])) for key in found[0]}
        rows.append({"photographs": label, "PSNR": float(np.mean(base)), **more})
        coarse, whole = np.sum([errors(scene, target) for target in targets], axis=0)
        rows[-1]["coarse share"] = float(coarse / whole)
    return rows


def pictures(scene: st.Scene, folder: Path, cameras: list[st.Camera]) -> Iterator[Target]:
    """Photographs with their cameras in the world of the scene, at the size that it was trained at."""
    division = json.loads(scene.source.metadata["training"])["division"]
    targets = Targets(folder, cameras)
    targets.placed(scene.source.near, np.asarray(scene.source.origin))
    for i in range(len(targets)):
        yield targets.at(i, division)


def causes(scene: st.Scene, target: Target) -> dict[str, float]:
    """PSNR of a picture, and without each cause, dB."""
    view = st.render(scene, target.camera)
    pair = Pair(view.image.astype(np.float64), target.photo / np.float64(255))
    depth = float(np.median(view.depth[view.depth > 0]))
    flat = replace(scene.gaussians, sh=np.ascontiguousarray(scene.gaussians.sh[:, :1]))
    plain = st.Scene.flat(flat, mode=scene.mode, source=scene.source)
    return {
        "PSNR": pair.psnr(),
        "pose": pair.psnr(turned(scene, target.camera, pair, depth)),
        "shift of each tile": pair.psnr(by_tiles(pair, moved)),
        **{f"blur of {sigma} px": pair.psnr(blurred(pair.image, sigma)) for sigma in BLURS_PX},
        "degree 0": pair.psnr(drawn(plain, target.camera)),
        "gain by radius": pair.psnr(brightened(pair)),
        "gain of each tile": pair.psnr(by_tiles(pair, fitted)),
    }


def errors(scene: st.Scene, target: Target) -> tuple[float, float]:
    """Mean squared error of a picture: what of it means over squares of `COARSE_PX` keep, and the whole."""
    pair = Pair(drawn(scene, target.camera), target.photo / np.float64(255))
    wrong = np.clip(fitted(pair.image, pair.photo), 0, 1) - pair.photo
    down, across = (side // COARSE_PX for side in wrong.shape[:2])
    wrong = wrong[: down * COARSE_PX, : across * COARSE_PX]
    coarse = wrong.reshape(down, COARSE_PX, across, COARSE_PX, 3).mean(axis=(1, 3))
    return float(np.square(coarse).mean()), float(np.square(wrong).mean())


def tiled(plane: np.ndarray) -> Iterator[tuple[tuple[slice, slice], np.ndarray]]:
    """Tiles of a picture with their places."""
    for top in range(0, plane.shape[0], TILE_PX):
        for left in range(0, plane.shape[1], TILE_PX):
            place = (slice(top, top + TILE_PX), slice(left, left + TILE_PX))
            yield place, plane[place]


def by_tiles(pair: Pair, change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """The picture with each tile changed towards its photograph, after the gain of the whole."""
    image, changed = fitted(pair.image, pair.photo), np.empty_like(pair.image)
    for place, _ in tiled(image):
        changed[place] = change(image[place], pair.photo[place])
    return changed


def moved(image: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """A tile, moved by the shift that brings it nearest to the photograph (Lucas and Kanade 1981); as it is if none does."""
    shift, best, least = np.zeros(2), image, np.square(image - photo).sum()
    for _ in range(4):
        now = shifted(image, shift)
        slopes = np.stack([np.gradient(now, axis=1), np.gradient(now, axis=0)], axis=-1).reshape(-1, 2)
        step = np.linalg.lstsq(slopes, (photo - now).reshape(-1), rcond=None)[0]
        shift = np.clip(shift + step, -3, 3)
        now = shifted(image, shift)
        if (error := np.square(now - photo).sum()) < least:
            best, least = now, error
    return best


def shifted(image: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """image(x + shift), cubic between the pixels (Keys 1981), with the border repeated."""
    for axis, by in ((1, shift[0]), (0, shift[1])):
        whole = int(np.floor(by))
        t = by - whole
        taps = np.array([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3]) / 2
        n = image.shape[axis]
        image = sum(
            w * np.take(image, np.clip(np.arange(n) + whole + k, 0, n - 1), axis)
            for k, w in zip((-1, 0, 1, 2), taps, strict=True)
        )
    return image


def turned(scene: st.Scene, camera: st.Camera, pair: Pair, depth: float) -> np.ndarray:
    """The view drawn from the pose that fits its photograph best, within a few steps."""
    best, most = pair.image, pair.psnr()
    for _ in range(POSE_ROUNDS):
        now = fitted(best, pair.photo)
        slopes = []
        for k in range(6):
            step = np.zeros(6)
            step[k] = POSE_STEP
            slopes.append((fitted(drawn(scene, posed(camera, step, depth)), pair.photo) - now) / POSE_STEP)
        # A few pixels that are all wrong must not decide: they are held at what most are wrong by.
        wrong = pair.photo - now
        scale = 3 * np.median(np.abs(wrong))
        weight = np.minimum(1, scale / np.maximum(np.abs(wrong), 1e-9)).reshape(-1)
        A = np.stack([s.reshape(-1) for s in slopes], axis=1)
        step = np.linalg.solve(A.T @ (A * weight[:, None]), A.T @ (wrong.reshape(-1) * weight))
        camera_now = posed(camera, step, depth)
        image = drawn(scene, camera_now)
        if pair.psnr(image) <= most:
            break
        best, most, camera = image, pair.psnr(image), camera_now
    return best


def drawn(scene: st.Scene, camera: st.Camera) -> np.ndarray:
    """The picture of a view."""
    return st.render(scene, camera).image.astype(np.float64)


def posed(camera: st.Camera, step: np.ndarray, depth: float) -> st.Camera:
    """A camera turned by three angles, rad, and moved by three parts of a depth."""
    x, y, z = step[:3]
    turn = np.eye(4)
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    u, _, v = np.linalg.svd(np.eye(3) + W + W @ W / 2)
    turn[:3, :3] = u @ v
    turn[:3, 3] = step[3:] * depth
    return replace(camera, camera_from_world=turn @ camera.camera_from_world)


def brightened(pair: Pair) -> np.ndarray:
    """The picture with a gain that changes with the square of the distance from the middle, and its square."""
    h, w = pair.image.shape[:2]
    row, column = np.mgrid[:h, :w]
    r2 = (np.square(row - h / 2) + np.square(column - w / 2)) / (h * h / 4 + w * w / 4)
    image = np.empty_like(pair.image)
    for c in range(3):
        basis = np.stack([pair.image[..., c] * r2**k for k in range(3)], axis=-1)
        flat = basis.reshape(-1, 3)
        image[..., c] = basis @ np.linalg.lstsq(flat, pair.photo[..., c].reshape(-1), rcond=None)[0]
    return image


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """A picture under a Gaussian of some pixels."""
    taps = np.exp(-0.5 * np.square(np.arange(-3, 4) / sigma))
    taps /= taps.sum()
    for axis in (0, 1):
        n = image.shape[axis]
        image = sum(w * np.take(image, np.clip(np.arange(n) + k - 3, 0, n - 1), axis) for k, w in enumerate(taps))
    return image


if __name__ == "__main__":
    main()
