"""Table 1: how each method chooses what to draw, what that costs, and what it does to the picture.

All methods choose from one tree, are drawn by one renderer and timed in one run, so that what differs is the choice alone; the
paper's methods were each trained by their own pipeline. Pictures are compared with photographs if there are any, else with the
picture of all leaves, which no choice from the same tree can beat.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from splatree.bench import paper
from splatree.bench.experiment import Report, Row, Table
from splatree.bench.measure import ALL_LEAVES, Judge
from splatree.bench.subject import Subject, SubjectOptions, subject_of
from splatree.errors import InputError
from splatree.lod.select import Selector
from splatree.progress import track
from splatree.scene.options import SelectOptions

__all__ = ["Options", "run"]


@dataclass(frozen=True)
class Options:
    """Compare methods of selection: PSNR, SSIM, t_f, FPS, N_P (FilterGS Table 1)."""

    subject: Annotated[SubjectOptions, arg(name="")] = SubjectOptions()
    pixel_error: float = 3.0
    """τ_R, px, of every method that has one."""
    frames: int = 100
    """Frames timed for each method, along a path through the views, after 20 to warm up."""

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise InputError(f"frames: found {self.frames}, wanted at least 1")


def run(options: Options) -> Report:
    """Draw all views and a path through them with each method."""
    subject = subject_of(options.subject)
    judge = Judge(subject)
    rows = [
        _row(judge, name, select, options.frames)
        for name, select in track(list(_methods(subject, options).items()), "methods")
    ]
    table = Table("table1", "Methods of selection on one tree, one renderer, one run", rows)
    return Report(
        "table1",
        "Methods of selection: quality, time of the selection, frames a second, pairs",
        {**subject.about, "rules": f"τ_R = {options.pixel_error:g} px; FPS and t_f over {options.frames} frames"},
        [table, paper.TABLE1],
    )


def _methods(subject: Subject, options: Options) -> Mapping[str, SelectOptions | Selector]:
    return {
        "all leaves (3DGS)": ALL_LEAVES,
        "log-serial": SelectOptions(options.pixel_error, rule="log-serial", profile="ref"),
        "cut (ours)": SelectOptions(options.pixel_error),
    }


def _row(judge: Judge, name: str, select: SelectOptions | Selector, frames: int) -> Row:
    quality = judge.quality(select)
    timing = judge.timing(select, frames=frames)
    return {
        "method": name,
        "PSNR": quality.psnr,
        "SSIM": quality.ssim,
        "t_f ms": timing.filter_ms,
        "FPS": timing.fps,
        "FPS p95": timing.fps_p95,
        "nodes": quality.num_selected,
        "N_P": quality.num_pairs,
    }
