"""What the viewer's server takes for a camera that moves: cuts for a browser that draws, and pictures for one that does not.

``python benchmarks/viewer.py SCENE`` needs a scene with levels, such as the shared city built by ``splatree build``. The
camera turns about the scene in steps of 2°, from the first view, and from a half and a third of its distance, in a window
of 960 × 540 px.

- *step*: the selection of at most ``--budget`` nodes, begun at the τ_R of the step before, and what takes the page there: new
  nodes, shapes of those that look otherwise by now, and colours.
- *step, exact*: the same where each budget is met to the node, looked for near the τ_R of the step before.
- *step, alone*: the same where each budget is met as for a view alone.
- *cut*: one selection by the τ_R that met the budget exactly.
- *picture*: drawn on the server as for ``--frames``, at the sizes that a page asks for while it moves, and made a JPEG; the mean
  of all steps, since the cut is chosen anew in some of them only.
- *picture, exact*: the same by itself, each budget searched from the last τ_R.
- *first picture*: bytes of the first message with nodes, and of all files of the page.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import splatree
from harness import Cost, measure, save, table
from splatree.render.moving import guarded_by
from splatree.view.client import FIRST_TAU_PX, LADDER
from splatree.view.exhibit import Exhibit, exhibit
from splatree.view.files import page_files
from splatree.view.pictures import encode, pixels_of
from splatree.view.slots import Slots

STEP_DEG = 2.0
GUARD = 0.08
"""What the page asks for beyond each border."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--budget", type=int, default=300_000)
    parser.add_argument("--steps", type=int, default=12)
    arguments = parser.parse_args()
    shown = exhibit(splatree.read(arguments.scene), arguments.scene.name)
    rows: list[dict[str, object]] = []
    for share in (1.0, 0.5, 0.3):
        cameras = [turned(shown, share, STEP_DEG * i) for i in range(arguments.steps + 1)]
        options = splatree.SelectOptions(budget=arguments.budget)
        rows += [
            {"distance": share, **row} for row in [*steps(shown, cameras, options), *pictures(shown, cameras, options)]
        ]
    rows.append({"distance": 1.0, **first_picture(shown)})
    print(table(rows))
    save(
        "viewer",
        rows,
        about=f"{shown.scene.tree.num_leaves:,} leaves, {len(shown.scene):,} nodes, a window of 960 × 540 px that turns by "
        f"{STEP_DEG:g}° a step, at most {arguments.budget:,} nodes: medians of {arguments.steps} steps; ms are processor time "
        "of all threads, pictures a second are by the clock",
    )


def steps(
    shown: Exhibit, cameras: list[splatree.Camera], options: splatree.SelectOptions
) -> Iterator[dict[str, object]]:
    """A step of a page that draws, with the budget met in three ways, and one cut."""

    def begun_at_last(camera: splatree.Camera, last: float) -> splatree.Selection:
        return shown.cut(camera, options, last)

    def near_last(camera: splatree.Camera, last: float) -> splatree.Selection:
        return shown.cut(camera, options, None)

    def alone(camera: splatree.Camera, last: float) -> splatree.Selection:
        return splatree.select(shown.scene, camera, options)

    def one_cut(camera: splatree.Camera, pixel_error: float) -> splatree.Selection:
        return splatree.select(shown.scene, camera, splatree.SelectOptions(pixel_error=pixel_error))

    found: list[float] = []
    for name, choose in (("step", begun_at_last), ("step, alone", alone), ("step, exact", near_last)):
        slots = Slots(shown.shown, shown.centre, 1 << 21)
        found, costs = [FIRST_TAU_PX], []
        for camera in cameras:
            chosen = measure(partial(choose, guarded_by(camera, GUARD), found[-1]))
            change = measure(partial(slots.move, chosen.value.rows, camera.position, shown.session.view(camera)))
            found.append(chosen.value.pixel_error)
            sent = len(change.value.add), len(change.value.shaped), len(change.value.payload) / 1e3
            costs.append((1e3 * chosen.cpu_s, 1e3 * change.cpu_s, len(chosen.value), *sent))
        select_ms, pack_ms, nodes, new, shapes, kilobytes = np.median(costs[1:], axis=0)
        both = {"ms": select_ms + pack_ms, "select ms": select_ms, "pack ms": pack_ms}
        yield {"what": name, **both, "nodes": int(nodes), "new": int(new), "shapes": int(shapes), "kB": kilobytes}
    cuts = [
        measure(partial(one_cut, guarded_by(camera, GUARD), pixel_error))
        for camera, pixel_error in zip(cameras[1:], found[2:], strict=True)
    ]
    cut_ms, nodes = np.median([(1e3 * cut.cpu_s, len(cut.value)) for cut in cuts], axis=0)
    yield {"what": "cut", "ms": cut_ms, "select ms": cut_ms, "nodes": int(nodes)}


def pictures(
    shown: Exhibit, cameras: list[splatree.Camera], options: splatree.SelectOptions
) -> Iterator[dict[str, object]]:
    """A picture for a page that does not draw, at three sizes: as a moving camera's, and each by itself."""
    for factor in (1.0, 0.5, 0.25):
        small = [camera.scaled(factor) for camera in cameras]
        limited = replace(options, budget=max(1000, int(factor * (options.budget or 0))))
        size = f"picture {small[0].width} × {small[0].height}"
        motion = shown.session.motion()
        moving = [measure(partial(motion.draw, camera, select=limited)) for camera in small]
        yield picture(size, [(drawn, drawn.value.image, drawn.value.selection) for drawn in moving], np.mean)
        last, alone = FIRST_TAU_PX, []
        for camera in small:
            drawn = measure(partial(shown.draw, camera, limited, (0.0, 0.0, 0.0), last=last))
            result, chosen = drawn.value
            last = chosen.pixel_error
            alone.append((drawn, result.image, chosen))
        yield picture(f"{size}, exact", alone, np.median)


def picture(
    what: str, frames: list[tuple[Cost, np.ndarray, splatree.Selection]], middle: Callable[..., np.ndarray]
) -> dict[str, object]:
    """What pictures after the first took, and the JPEG files made of them."""
    costs = []
    for drawn, image, chosen in frames[1:]:
        file = measure(partial(encode, pixels_of(image), "jpeg", 75))
        seconds = drawn.wall_s + file.wall_s
        costs.append((1e3 * drawn.cpu_s, 1e3 * file.cpu_s, len(chosen), len(file.value) / 1e3, seconds))
    draw_ms, file_ms, nodes, kilobytes, seconds = middle(costs, axis=0)
    both = {"ms": draw_ms + file_ms, "draw ms": draw_ms, "JPEG ms": file_ms}
    return {"what": what, **both, "nodes": int(nodes), "kB": kilobytes, "a second": 1 / seconds}


def first_picture(shown: Exhibit) -> dict[str, object]:
    """Bytes until there is a picture, and what they take."""
    camera = turned(shown, 1.0, 0.0)
    slots = Slots(shown.shown, shown.centre, 1 << 21)
    options = splatree.SelectOptions(budget=LADDER[0])
    chosen = measure(lambda: shown.cut(guarded_by(camera, GUARD), options, FIRST_TAU_PX))
    change = measure(lambda: slots.move(chosen.value.rows, camera.position, shown.session.view(camera)))
    costs = {"ms": 1e3 * (chosen.cpu_s + change.cpu_s), "select ms": 1e3 * chosen.cpu_s, "pack ms": 1e3 * change.cpu_s}
    page = sum(len(data) for data, _ in page_files().values()) / 1e3
    nodes, kilobytes = len(chosen.value), len(change.value.payload) / 1e3
    return {"what": f"first picture (the page: {page:.0f} kB)", **costs, "nodes": nodes, "new": nodes, "kB": kilobytes}


def turned(shown: Exhibit, share: float, degrees: float) -> splatree.Camera:
    """The first view at a share of its distance, turned about the vertical through its target."""
    framing, angle = shown.framing, np.radians(degrees)
    offset, up = (framing.eye - framing.target) * share, framing.up
    offset = offset * np.cos(angle) + np.cross(up, offset) * np.sin(angle) + up * (up @ offset) * (1 - np.cos(angle))
    camera = splatree.Camera.look_at(
        framing.target + offset, framing.target, up=up, width=960, height=540, fov_y_deg=framing.fov_y_deg
    )
    return replace(camera, near=framing.camera().near)


if __name__ == "__main__":
    main()
