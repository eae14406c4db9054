"""The accelerator on real scenes: what clusters, buffers and orders are worth, and a machine that is faster at equal area.

    python benchmarks/accelerator.py [--views 4] [--clusters 8192] [--no-levels]
    python benchmarks/accelerator.py --only-levels --scenes robot logo

Three tables are kept. `accelerator`: clusters off, Eq. 3 of Jo 2024 and exact, with single and ping-pong buffers, in each order.
`accelerator_better`: changes of the machine, one after the other and all together, with their area and what they do to the
picture. `accelerator_levels`: levels of detail selected on the chip. Scenes are those of ../shared/data; each scene's frames are
drawn once for a rule, and all machines run on these.
"""

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, save, table
from splatree.hardware.config import Machine
from splatree.hardware.presets import PRESETS, changed
from splatree.hardware.study import draw_traces, on_machine
from splatree.hardware.trace import FrameTrace
from splatree.io.cameras.files import read_cameras
from splatree.progress import track

SCENES = {
    "city": ("trained/semarang_city", "cameras/semarang_city_made_views.json"),
    "robot": ("trained/playbot", None),
    "logo": ("trained/playcanvas_logo", None),
}
ORDERS = ("oracle", "frequency", "previous-frame", "two-level", "morton", "index", "adversarial")
RULES = {"off": None, "Eq. 3": "paper", "exact": "exact"}
PSNR_MAX = 100.0
"""dB that stand for equal pictures in a mean."""
PIXEL_ERRORS = (1.0, 2.0)
JO = PRESETS["jo2024"]
CHANGES: dict[str, tuple[str, ...]] = {
    "jo2024, fp32": (),
    "bursts of 32 bytes": ("dram.line_bytes=32",),
    "frames overlap": ("back.overlaps=true",),
    "boxes instead of spheres": ("identification.rule=boxes",),
    "fp16 records": ("records.format=fp16",),
    "8-bit records": ("records.format=fixed",),
    "8-bit records, bursts of 32 bytes": ("records.format=fixed", "dram.line_bytes=32"),
    "splatree: all but boxes": ("records.format=fixed", "dram.line_bytes=32", "back.overlaps=true"),
}


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene of leaves with clusters, and its views."""

    name: str
    scene: st.Scene
    views: tuple[st.Camera, ...]

    def traces(self, machine: Machine) -> tuple[FrameTrace, ...]:
        return draw_traces(self.scene, self.views, machine)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--views", type=int, default=4, help="views of each scene")
    parser.add_argument("--clusters", type=int, default=8192, help="clusters of each scene")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES), help="scenes")
    parser.add_argument("--no-levels", action="store_true", help="leave out levels of detail, whose trees take minutes")
    parser.add_argument("--only-levels", action="store_true", help="levels of detail alone")
    args = parser.parse_args()
    ideas: list[dict[str, object]] = []
    better: list[dict[str, object]] = []
    levels: list[dict[str, object]] = []
    for subject in track([subject_of(name, args.views, args.clusters) for name in args.scenes], "scenes"):
        if not args.only_levels:
            ideas += idea_rows(subject)
            better += better_rows(subject)
        if not args.no_levels:
            levels += level_rows(subject, args.clusters)
        keep(ideas, better, levels)  # after each scene: trees of large ones take minutes
    print(*(table(rows) for rows in (ideas, better, levels) if rows), sep="\n\n")


def keep(ideas: list[dict[str, object]], better: list[dict[str, object]], levels: list[dict[str, object]]) -> None:
    means = "means of the views, FPS: frames over the sum of their times"
    psnr = "PSNR: with the picture of all leaves in fp32, mean of the views, 100 dB: equal"
    abouts = {
        "accelerator": f"The accelerator of Jo 2024 on real scenes: {means}. Columns of orders: cycles against the oracle's, %.",
        "accelerator_better": f"Changes of the accelerator at equal bandwidth: {means}. {psnr}.",
        "accelerator_levels": f"Levels of detail selected on the accelerator, at equal bandwidth: {means}. {psnr}.",
    }
    for (name, about), rows in zip(abouts.items(), (ideas, better, levels), strict=True):
        if rows:
            save(name, rows, about=about)


def subject_of(name: str, views: int, clusters: int) -> Subject:
    path, cameras = SCENES[name]
    scene = st.read(DATA / path)
    leaves = st.Scene.flat(scene.gaussians.take(scene.tree.is_leaf), mode=scene.mode)
    if cameras is None:
        seen = list(st.flyout(leaves, st.PathOptions(views=views, width=1280, height=720)))
    else:
        known = list(read_cameras(DATA / cameras))
        seen = [known[i] for i in np.linspace(0, len(known) - 1, views).round().astype(int)]
    return Subject(name, st.build_clusters(leaves, min(clusters, len(leaves))), tuple(seen))


def idea_rows(subject: Subject) -> Iterator[dict[str, object]]:
    """The paper's ideas, taken away one by one."""
    for rule_name, rule in RULES.items():
        settings = [f"identification.rule={rule}"] if rule else ["clustering=false"]
        machine = changed(JO, settings)
        traces = subject.traces(machine)
        for buffers, ping_pong in (("single", False), ("ping-pong", True)):
            one = replace(machine, ping_pong=ping_pong)
            found = {
                order: on_machine(replace(one, order=order), traces) for order in (ORDERS if rule else ("frequency",))
            }
            mean = found["frequency"]
            row: dict[str, object] = {
                "scene": subject.name,
                "clusters": rule_name,
                "buffers": buffers,
                "excluded %": 100 * mean.exclusion,
                "MB": float(np.mean([frame.total_bytes for frame in mean.frames])) / 1e6,
                "M cycles": float(np.mean([frame.cycles for frame in mean.frames])) / 1e6,
                "FPS": mean.fps,
                "mJ": mean.millijoules,
            }
            if rule:
                oracle = found["oracle"].milliseconds
                row |= {order: 100 * (found[order].milliseconds / oracle - 1) for order in ORDERS[1:]}
            yield row


def better_rows(subject: Subject) -> Iterator[dict[str, object]]:
    """Changes of the machine at the bandwidth of `jo2024`; the first is the machine as it is."""
    drawn = {rule: subject.traces(changed(JO, [f"identification.rule={rule}"])) for rule in ("exact", "boxes")}
    pictures = [st.render(subject.scene, view).image for view in subject.views]
    coarse = mean_psnr([st.render(through_spz(subject.scene), view).image for view in subject.views], pictures)
    first = on_machine(JO, drawn["exact"])
    for name, settings in CHANGES.items():
        machine = changed(JO, settings)
        psnr = {"fp32": PSNR_MAX, "fixed": coarse}.get(machine.records.format)
        yield change_row(subject.name, name, machine, drawn[machine.identification.rule], first.milliseconds, psnr)


def level_rows(subject: Subject, clusters: int) -> Iterator[dict[str, object]]:
    """The cut of levels by pairs on the paper's machine and on ours; the first row of each scene draws all leaves."""
    pictures = [st.render(subject.scene, view).image for view in subject.views]
    leaves = subject.traces(JO)
    first = on_machine(JO, leaves)
    yield change_row(subject.name, "jo2024, all leaves", JO, leaves, first.milliseconds, PSNR_MAX)
    ours = PRESETS["splatree"]
    yield change_row(subject.name, "splatree, all leaves", ours, leaves, first.milliseconds, None)
    tree = st.build_clusters(
        st.build_lod(subject.scene, st.BuildOptions(method="pairs")), min(clusters, len(subject.scene))
    )
    for pixel_error in PIXEL_ERRORS:
        select = st.SelectOptions(pixel_error=pixel_error)
        images = [st.render(tree, view, select=select).image for view in subject.views]
        for name, start in (("jo2024", JO), ("splatree", PRESETS["splatree"])):
            machine = changed(start, ["selects_levels=true"])
            traces = draw_traces(tree, subject.views, machine, select=select)
            psnr = mean_psnr(images, pictures) if name == "jo2024" else None
            label = f"{name}, levels up to {pixel_error:g} px"
            yield change_row(subject.name, label, machine, traces, first.milliseconds, psnr)


def change_row(
    scene: str, name: str, machine: Machine, traces: Sequence[FrameTrace], first_ms: float, psnr: float | None
) -> dict[str, object]:
    found = on_machine(machine, traces)
    return {
        "scene": scene,
        "machine": name,
        "frame ms": found.milliseconds,
        "FPS": found.fps,
        "speed-up": first_ms / found.milliseconds,
        "MB": float(np.mean([frame.total_bytes for frame in found.frames])) / 1e6,
        "mJ": found.millijoules,
        "mm2": found.area.mm2,
        "PSNR": "" if psnr is None else psnr,
    }


def through_spz(scene: st.Scene) -> st.Scene:
    """The scene with 24-bit means, 8-bit scales and harmonics of at most 8 bits, as SPZ keeps them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.spz"
        st.write(scene, path)
        return replace(st.read(path), mode=scene.mode, threshold=scene.threshold)


def mean_psnr(images: Sequence[np.ndarray], references: Sequence[np.ndarray]) -> float:
    return float(np.mean([min(st.psnr(a, b), PSNR_MAX) for a, b in zip(images, references, strict=True)]))


if __name__ == "__main__":
    main()
