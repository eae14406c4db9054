"""Table 1: how each method chooses what to draw, what that costs, and what it does to the picture.

All methods choose from one tree, are drawn by one renderer (the exact test of tiles at 1/255) and timed in one run, so that what
differs is the choice alone; the paper's methods were each trained by their own pipeline. Pictures are compared with photographs
if there are any, else with the picture of all leaves, which no choice from the same tree can beat.

With ``train`` the scene is trained on the photographs first, all but the held-out ones, which the pictures are compared with.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from tyro.conf import arg

from splatree.bench import paper
from splatree.bench.experiment import Curve, Plot, Report, Row, Table
from splatree.bench.measure import Judge, number
from splatree.bench.subject import Subject, SubjectOptions, subject_of
from splatree.errors import InputError
from splatree.lod.baselines import Baseline, BaselineName, BaselineOptions, baseline, violations
from splatree.lod.select import Selector
from splatree.metrics.lpips import Lpips, Net
from splatree.progress import track
from splatree.render.timing import check_frames
from splatree.scene.literals import check_literals
from splatree.scene.options import SelectOptions
from splatree.train.options import TrainOptions
from splatree.train.run import train

__all__ = ["Options", "run"]

LABELS: dict[BaselineName, str] = {
    "3dgs": "3DGS: all leaves",
    "roots": "roots",
    "depth": "one depth",
    "h3dgs": "H3DGS",
    "serial": "level by level",
    "log-serial": "LoG",
    "octree": "Octree-GS, first hit",
    "octree-per-node": "Octree-GS",
    "flod": "FLoD, first hit",
    "flod-per-node": "FLoD",
    "lodge": "LODGE",
    "filtergs": "FilterGS, exact",
    "filtergs-strict": "FilterGS, literal",
    "filtergs-release": "FilterGS, its code",
}
OURS = "splatree"

TrainedLevels = Literal["radius", "pairs", "grow"]
"""How a scene that is trained gets its levels."""


@dataclass(frozen=True)
class Options:
    """Compare methods of selection: PSNR, SSIM, FLIP, t_f, FPS, N_P (FilterGS, Table 1)."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions()
    methods: Annotated[BaselineOptions, arg(name="", help="")] = BaselineOptions()
    train: float | None = None
    """Minutes of processor time to train a scene on the photographs of --data first, in place of --scene; the held-out ones are
    not opened for that. None: nothing is trained."""
    levels: TrainedLevels = "radius"
    """With --train: levels that are merged after training, by `radius` or `pairs`, or `grow` in it, as the paper's do."""
    max_gaussians: int = 200_000
    """With --train: leaves at most."""
    frames: int = 100
    """Frames timed for each method, along a path through the views, after as many, at most 20, to warm up."""
    lpips: Net | None = None
    """Also LPIPS by this network; needs the extra `lpips` and its weights."""
    lpips_trunk: Path | None = None
    """Weights of the classifier, from torchvision; None: where torch keeps them."""
    lpips_heads: Path | None = None
    """Weights of LPIPS version 0.1; None: from an installed package lpips or torchmetrics."""

    def __post_init__(self) -> None:
        check_literals(self)
        check_frames(self.frames)
        if self.lpips is None and (self.lpips_trunk or self.lpips_heads):
            raise InputError(
                "lpips_trunk, lpips_heads: found weights without --lpips, wanted the name of their network, too"
            )
        if self.train is not None:
            if self.subject.data is None:
                raise InputError("train: found no photographs to train on, wanted their folder: --data")
            if self.subject.scene:
                raise InputError(f"train: found {self.subject.scene[0]} beside it, wanted either a scene or training")
            _training(self)  # which refuses what it cannot do, before any work


def run(options: Options) -> Report:
    """Draw all views and a path through them with each method."""
    network = Lpips(options.lpips, trunk=options.lpips_trunk, heads=options.lpips_heads) if options.lpips else None
    subject, about = _subject(options)
    judge = Judge(subject, network, wants_flip=True)
    methods = track(list(_methods(subject, options.methods)), "methods")
    rows = [_row(judge, name, select, num_bytes, options.frames) for name, select, num_bytes in methods]
    rules = f"τ_R = {options.methods.pixel_error:g} px where a method has one; t_f, FPS over {options.frames} frames"
    return Report(
        "table1",
        "Methods of selection: quality, time of the selection, frames a second, pairs",
        {**subject.about, **about, "rules": rules},
        [Table("table1", "Methods of selection on one tree, one renderer, one run", rows, notes=NOTES), paper.TABLE1],
        [_frontier(rows)],
    )


def _training(options: Options) -> TrainOptions:
    return TrainOptions(
        minutes=options.train,
        max_gaussians=options.max_gaussians,
        held_out=options.subject.held_out,
        levels=options.levels,
        score=False,
    )


def _subject(options: Options) -> tuple[Subject, dict[str, str]]:
    """The scene as it is, or trained, and how it was trained."""
    if options.train is None:
        return subject_of(options.subject), {}
    assert options.subject.data is not None  # the options hold to it
    found = train(options.subject.data, _training(options), cameras=options.subject.cameras)
    last = found.history[-1]
    words = f"{last.cpu_s / 60:.2g} minutes of processor time, {last.iterations:,} steps, levels: {options.levels}"
    return subject_of(options.subject, trained=found.scene), {"training": f"{words}; {found.rule}"}


NOTES = (
    "t_f, frame: the selection and all of a frame, ms of the clock or of all processors; FPS p95: 95 of 100 frames are as fast.",
    "twice, missing: nodes drawn below another drawn one, and leaves that nothing stands for, seen or not; means of the views.",
    "B/node: data of the selection beside subtree_end and depth; lists of rows made beforehand are counted, and so are indices.",
    "Methods see one tree here, not the one of their own training: this compares selections, not methods as a whole.",
)


def _methods(subject: Subject, options: BaselineOptions) -> Iterator[tuple[str, SelectOptions | Selector, int]]:
    """Made one after the other: tables of large scenes take memory."""
    for method in get_args(BaselineName):
        made = baseline(method, subject.scene, subject.training, options)
        yield LABELS[method], made, made.num_bytes
    assert subject.scene.blocks is not None
    yield OURS, SelectOptions(options.pixel_error), subject.scene.blocks.nbytes


def _row(judge: Judge, name: str, select: SelectOptions | Selector, num_bytes: int, frames: int) -> Row:
    subject = judge.subject
    quality = judge.quality(select)
    timing = judge.timing(select, frames=frames)
    row: dict[str, object] = {"method": name, "PSNR": quality.psnr, "SSIM": quality.ssim, "FLIP": quality.flip}
    if quality.lpips is not None:
        row["LPIPS"] = quality.lpips
    row |= {
        "t_f ms": timing.filter_ms,
        "t_f CPU": timing.cpu_ms["select"],
        "frame CPU": timing.frame_cpu_ms,
        "FPS": timing.fps,
        "FPS p95": timing.fps_p95,
        "nodes": round(quality.num_selected),
        "N_P": round(quality.num_pairs),
    }
    if isinstance(select, Baseline):
        found = [violations(subject.scene.tree, select.cut(camera)) for camera in subject.cameras]
        row["twice"] = round(float(np.mean([v.duplicates for v in found])))
        row["missing"] = round(float(np.mean([v.uncovered for v in found])))
    else:
        row |= {"twice": 0, "missing": 0}  # laws of the cut, held by the tests
    return row | {"B/node": num_bytes / len(subject.scene)}


def _frontier(rows: list[Row]) -> Plot:
    """The methods that adapt to the view; all leaves and single depths lie far from these."""
    rows = [row for row in rows if row["method"] not in (LABELS["3dgs"], LABELS["roots"], LABELS["depth"])]
    curves = [Curve(str(row["method"]), [number(row, "N_P")], [number(row, "PSNR")]) for row in rows]
    return Plot("table1_frontier", "Quality over pairs", "N_P", "PSNR, dB", curves)
