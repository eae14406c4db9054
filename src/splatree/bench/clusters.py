"""Cluster culling, measured as Jo 2024 does (Table I, Fig. 6) and beyond: exclusion, what is lost, and what a frame costs.

All Gaussians of the scene are drawn, without levels of detail: step 0 leaves out clusters, step 1 projects what is left, the
rest is binning and blending. The exclusion rate of a rule is the share of Gaussians that it leaves out; the ideal is the share
that does not survive step 1; efficiency is the first over the second. A rule loses a survivor if it leaves one out.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from tyro.conf import arg

from splatree.bench import jo2024
from splatree.bench.experiment import Curve, Plot, Report, Row, Table
from splatree.bench.subject import Subject, SubjectOptions, subject_of
from splatree.clusters.build import ClusterOptions, build_clusters
from splatree.clusters.cull import cull
from splatree.errors import InputError
from splatree.kernels.cpu.frame.project import project
from splatree.lod.blocks import with_blocks
from splatree.lod.select import cull_scene, select
from splatree.progress import track
from splatree.render.build import build_lod
from splatree.render.evaluate import score
from splatree.render.session import open_session
from splatree.render.timing import check_frames
from splatree.scene.cameras import Camera
from splatree.scene.options import Cull, RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import view_of
from splatree.shapes import Array

__all__ = ["Options", "run"]

RULES: tuple[Cull, ...] = (
    "paper-distance",
    "paper",
    "paper-guard",
    "planes",
    "exact-inria",
    "exact-gsplat",
    "exact",
)
DRAWN: tuple[Cull, ...] = ("paper-distance", "paper", "exact")
"""Rules whose pictures are drawn and compared."""
OPERATIONS = 5 * 7 + 3 * 2 + 4 + 5 * (7 + 7) + 3 * (2 + 2) + 3 * 2 + 2
"""Of a cluster: five planes of three products, three sums and a comparison; distance from the eye; radii with margins. Of its box
the same, and the half sizes on each plane; its centre and half sizes."""
RECORD_BYTES = 12 + 4 + 4 + 24
"""Of a cluster: centre, radius, radius for the near plane, box."""
ROW_BYTES = 12 + 16 + 12 + 4
"""Of a Gaussian in step 1, before its colour: mean, quaternion, log-scales, opacity."""
PSNR_MAX = 100.0
"""dB at which a view counts at most in a mean; equal pictures have infinity."""
REPEAT = 5
"""Runs of what takes less than some milliseconds, of which the cheapest counts."""


@dataclass(frozen=True)
class Options:
    """Measure cluster culling: exclusion, quality, survivors lost, time of each step (Jo 2024, Table I and Fig. 6)."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions()
    clusters: tuple[int, ...] = (2048, 8192, 32768)
    """Numbers of clusters; more than Gaussians are left out."""
    clustering: Annotated[ClusterOptions, arg(name="", help="")] = ClusterOptions()
    frames: int = 3
    """Frames of each view that are drawn in each way, for the table of processor times; the cheapest counts."""
    levels: bool = False
    """Also measure culling in front of the selection in a tree of levels, which is built if the scene has none."""

    def __post_init__(self) -> None:
        if not self.clusters or min(self.clusters) < 1:
            raise InputError(f"clusters: found {self.clusters}, wanted at least one number of 1 or more")
        check_frames(self.frames)


def run(options: Options) -> Report:
    """Draw all views without culling and with each rule, for each number of clusters."""
    subject = subject_of(options.subject, levels=False)
    flat = _leaves_of(subject.scene)
    numbers = [k for k in options.clusters if k <= len(flat)] or [len(flat)]
    rules, breakdown, overhead = [], [], []
    for number in track(numbers, "numbers of clusters"):
        start = time.process_time()
        scene = build_clusters(flat, number, options.clustering)
        built_cpu_s = time.process_time() - start
        measured = [_View(scene, camera, subject) for camera in subject.cameras]
        rules += [_rule_row(number, rule, measured) for rule in ("none", *RULES)]
        breakdown += _breakdown_rows(number, measured, options.frames)
        overhead.append(_overhead_row(scene, measured, built_cpu_s))
    tables = [
        Table("clusters_rules", "What each rule leaves out, and what that changes", rules, notes=RULE_NOTES),
        Table("clusters_breakdown", "Processor time of a frame, ms", breakdown, notes=BREAKDOWN_NOTES),
        Table("clusters_overhead", "What step 0 takes, beside step 1 without it", overhead, notes=OVERHEAD_NOTES),
    ]
    if options.levels:
        tables.append(_levels_table(subject, numbers))
    tables.append(jo2024.table())
    about = {**subject.about, "drawn": f"all {len(flat):,} Gaussians, no levels; K-means: {options.clustering}"}
    return Report("clusters", "Culling of clusters", about, tables, [_exclusion(rules)])


RULE_NOTES = (
    "none: step 1 alone, its exclusion is the ideal. lost: survivors of our projection left out, mean of a view.",
    "px changed: pixels of which a bit changed; PSNR, SSIM: with the unculled picture, or photographs if given; 100 dB at most.",
    "Rules without them were not drawn.",
)
BREAKDOWN_NOTES = (
    "Processor ms of all threads, means over the views. step 1: list of rows and projection; rest: binning and blending.",
    "excluded: rows that the projection is not asked for. step 1 saved: of that of all rows, drawn in the same way.",
    "Our projection begins with a bound from mean and scales, so a row beyond the picture costs less than one in it.",
    "squares: splats end as in Kerbl 2023, the paper's step 1: every row is read whole and projected; exact is that for squares.",
    "packing: what the paper's implementation on a GPU does: kept rows of every attribute are copied, then projected.",
    "blocks: no clusters, but the selection's own test of blocks of 256 rows and of footprints, as drawn by default; "
    "blocks, exact: both.",
    "theirs (Jo 2024, §1, §2.2, §4.1; RTX A6000, not measured here): "
    + "; ".join(f"{name} {figure:g}" for name, figure in jo2024.BREAKDOWN.items()),
)
OVERHEAD_NOTES = (
    f"A cluster takes {OPERATIONS} operations and {RECORD_BYTES} bytes; a Gaussian of step 1 {ROW_BYTES} without colour.",
)


class _View:
    """Pictures of one view: without culling, and with each rule that is drawn."""

    def __init__(self, scene: Scene, camera: Camera, subject: Subject) -> None:
        self.scene, self.camera, self.session = scene, camera, open_session(scene)
        whole = self.session.trace(camera, select=_all_rows("none"))
        self.whole, self.cpu_ms = whole.result.image, whole.result.cpu_milliseconds
        self.survives = np.zeros(len(scene), bool)
        self.survives[whole.splats.rows] = True
        self.images = {rule: self.session.draw(camera, select=_all_rows(rule)).image for rule in DRAWN}
        photos = subject.photos
        self.reference = photos[camera.name] if photos and camera.name in photos else self.whole

    def left_out(self, rule: Cull) -> Array:
        """Rows that a rule leaves out."""
        assert self.scene.clusters is not None
        kept = np.zeros(len(self.scene), bool)
        kept[cull(self.scene.clusters, view_of(self.scene, self.camera), rule).rows] = True
        return ~kept


def _all_rows(rule: Cull) -> SelectOptions:
    """Everything that culling leaves; what cannot be seen is found by step 1."""
    return SelectOptions(pixel_error=0.0, view_test="none", cull=rule)


def _leaves_of(scene: Scene) -> Scene:
    """The scene without levels."""
    if scene.tree.num_levels <= 1:
        return scene
    flat = Scene.flat(scene.gaussians.take(scene.tree.is_leaf), mode=scene.mode, source=scene.source)
    return replace(flat, threshold=scene.threshold)


def _rule_row(number: int, rule: Cull, views: list[_View]) -> Row:
    ideal = float(np.mean([1 - view.survives.mean() for view in views]))
    row: dict[str, object] = {"K": number, "rule": rule}
    if rule == "none":
        scores = [score(view.whole, view.reference) for view in views]
        row |= {"excluded %": 100 * ideal, "efficiency": 1.0, "lost": 0.0, "px changed": 0.0}
    else:
        left_out = [view.left_out(rule) for view in views]
        excluded = float(np.mean([rows.mean() for rows in left_out]))
        row |= {"excluded %": 100 * excluded, "efficiency": excluded / ideal if ideal else 0.0}
        pairs = zip(left_out, views, strict=True)
        row["lost"] = float(np.mean([(rows & view.survives).sum() for rows, view in pairs]))
        if rule not in DRAWN:
            return row
        row["px changed"] = float(np.mean([_changed(view.whole, view.images[rule]) for view in views]))
        scores = [score(view.images[rule], view.reference) for view in views]
    row["PSNR"] = float(np.mean([min(s.psnr, PSNR_MAX) for s in scores]))
    row["SSIM"] = float(np.mean([s.ssim for s in scores if s.ssim is not None]))
    return row


def _changed(one: Array, other: Array) -> int:
    """Pixels of which any bit differs."""
    bits = (np.ascontiguousarray(image).view(np.uint32) for image in (one, other))
    return int(np.not_equal(*bits).any(axis=-1).sum())


def _breakdown_rows(number: int, views: list[_View], frames: int) -> list[Row]:
    """A frame without step 0, with it, with it and packing, and as the selection by blocks does it."""

    # In turn, so that all ways share what else the machine does; of each step the cheapest run counts.
    runs = [{name: frame(view) for name, frame in BREAKDOWNS.items()} for view in views for _ in range(frames)]

    def mean_of(name: str, column: str) -> float:
        values = np.array([run[name].get(column, 0.0) for run in runs]).reshape(len(views), frames)
        return float(values.min(axis=1).mean())

    means = {name: {column: mean_of(name, column) for column in (EXCLUDED, *STAGES)} for name in BREAKDOWNS}

    def row(name: str, part: dict[str, float]) -> Row:
        whole = means["squares" if name.startswith("squares") else "without step 0"]["step 1"]
        saved = 100 * (1 - part["step 1"] / whole)
        total = sum(part[stage] for stage in STAGES)
        return {"K": number, "frame": name} | part | {"total": total, "step 1 saved %": saved}

    return [row(name, part) for name, part in means.items()]


STAGES = ("step 0", "packing", "step 1", "rest")
EXCLUDED = "excluded %"


def _traced(select: SelectOptions, options: RenderOptions | None = None) -> Callable[[_View], dict[str, float]]:
    def frame(view: _View) -> dict[str, float]:
        drawn = view.session.trace(view.camera, options=options, select=select)
        ms = drawn.result.cpu_milliseconds
        return {
            EXCLUDED: 100 * (1 - len(drawn.selection.rows) / len(view.scene)),
            "step 0": ms.get("cull", 0.0) if select.cull != "none" else 0.0,
            "step 1": ms["select"] + ms["project"],
            "rest": ms["bin"] + ms["blend"],
        }

    return frame


SQUARES = RenderOptions(tile_rule="3sigma")


def _packed(view: _View) -> dict[str, float]:
    """Step 0, a copy of all kept rows, and the frame of these."""
    start = time.process_time()
    seen = view_of(view.scene, view.camera)
    culling = cull_scene(view.scene, seen, _all_rows("exact"))
    culled = time.process_time()
    assert culling is not None
    packed = view.scene.gaussians.take(culling.rows)
    ids = None if view.scene.ids is None else view.scene.ids[culling.rows]
    copied = time.process_time()
    project(packed, ids, np.arange(len(packed), dtype=np.int32), seen)
    projected = time.process_time()
    rest = view.cpu_ms
    return {
        EXCLUDED: 100 * (1 - len(packed) / len(view.scene)),
        "step 0": 1e3 * (culled - start),
        "packing": 1e3 * (copied - culled),
        "step 1": 1e3 * (projected - copied),
        "rest": rest["bin"] + rest["blend"],
    }


BREAKDOWNS: dict[str, Callable[[_View], dict[str, float]]] = {
    "without step 0": _traced(_all_rows("none")),
    "exact": _traced(_all_rows("exact")),
    "paper": _traced(_all_rows("paper")),
    "exact, packing": _packed,
    "blocks": _traced(SelectOptions(pixel_error=0.0, cull="none")),
    "blocks, exact": _traced(SelectOptions(pixel_error=0.0, cull="exact")),
    "squares": _traced(_all_rows("none"), SQUARES),
    "squares, exact": _traced(_all_rows("exact"), SQUARES),
    "squares, paper": _traced(_all_rows("paper"), SQUARES),
}
"""Ways to draw the same picture; those of squares are of other splats, and of each other's."""


def _overhead_row(scene: Scene, views: list[_View], built_cpu_s: float) -> Row:
    assert scene.clusters is not None
    number, n = len(scene.clusters), len(scene)
    spent = np.mean(
        [_cheapest(partial(cull_scene, scene, view_of(scene, view.camera), _all_rows("exact"))) for view in views]
    )
    step_1 = float(np.mean([view.cpu_ms["project"] for view in views]))
    return {
        "K": number,
        "rows/cluster": n / number,
        "median radius": float(np.median(scene.clusters.radii)),
        "operations": OPERATIONS * number,
        "bytes": RECORD_BYTES * number,
        "% of bytes": 100 * RECORD_BYTES * number / (ROW_BYTES * n),
        "CPU ms": float(spent),
        "% of step 1": 100 * float(spent) / step_1,
        "build CPU s": built_cpu_s,
    }


def _cheapest(work: Callable[[], object]) -> float:
    """Processor milliseconds of the cheapest of some runs."""

    def once() -> float:
        start = time.process_time()
        work()
        return 1e3 * (time.process_time() - start)

    return min(once() for _ in range(REPEAT))


def _levels_table(subject: Subject, numbers: list[int]) -> Table:
    """Culling and selection in a tree, beside the selection alone."""
    tree = subject.scene
    if tree.tree.num_levels <= 1:
        tree = build_lod(tree)
    rows: list[Row] = []
    for number in numbers:
        scene = with_blocks(build_clusters(tree, number))
        for camera in subject.cameras:
            alone, both = (
                _cheapest(partial(select, scene, camera, SelectOptions(cull=rule))) for rule in ("none", "exact")
            )
            culling = cull_scene(scene, view_of(scene, camera), SelectOptions(cull="exact"))
            assert culling is not None
            rows.append(
                {
                    "K": len(culling.kept),
                    "view": camera.name,
                    "excluded %": 100 * (1 - culling.num_rows / len(scene)),
                    "select CPU ms": alone,
                    "cull + select CPU ms": both,
                    "ratio": both / alone,
                }
            )
    notes = (f"{len(tree):,} nodes; clusters are complete subtrees. Both choose the same rows.",)
    return Table("clusters_levels", "Culling in front of the selection by blocks", rows, notes=notes)


def _exclusion(rows: list[Row]) -> Plot:
    labels = {"none": "ideal", "paper-distance": "only distance", "paper": "Eq. 3", "exact": "exact"}
    curves = []
    for rule, label in labels.items():
        of_rule = [row for row in rows if row["rule"] == rule]
        x = [float(row["K"]) for row in of_rule]  # type: ignore[arg-type]
        curves.append(Curve(label, x, [float(row["excluded %"]) for row in of_rule]))  # type: ignore[arg-type]
    title = "Gaussians left out before step 1"
    return Plot("clusters_exclusion", title, "clusters", "excluded, %", curves, log_x=True)
