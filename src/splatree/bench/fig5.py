"""Figure 5: ways to end splats, on all leaves and on the cut, with details of the pictures.

The paper's rows are the first, second and fourth way; its text says λ_G / G and its code computes λ_G · G, so both are drawn.
"""

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from splatree.bench import paper
from splatree.bench.crops import busiest
from splatree.bench.experiment import Grid, Panel, Report, Row, Table
from splatree.bench.measure import ALL_LEAVES, Judge, number, shrinking_row
from splatree.bench.shrinking import ABOUT_LOSS, THREE_SIGMA, ways
from splatree.bench.subject import SubjectOptions, subject_of
from splatree.progress import track
from splatree.render.pipeline import render
from splatree.render.timing import check_frames
from splatree.scene.options import SelectOptions

__all__ = ["Options", "run"]


@dataclass(frozen=True)
class Options:
    """Compare ways to end splats on all leaves and on the cut: PSNR, FPS, N_P, details (FilterGS, Figure 5)."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions(views=4)
    pixel_error: float = 3.0
    """τ_R of the cut, px."""
    lambda_g: float = 0.2
    """λ_G of the paper."""
    loss_db: float = 0.1
    """Loss of PSNR that ours may cost, dB."""
    frames: int = 30
    """Frames timed for each row, along a path through the views, after as many, at most 20, to warm up."""

    def __post_init__(self) -> None:
        check_frames(self.frames)


def run(options: Options) -> Report:
    """Draw, compare and time each way with both selections."""
    subject = subject_of(options.subject)
    judge = Judge(subject)
    camera = subject.cameras[0]
    window = busiest(judge.references[camera.name])
    rows: list[Row] = []
    panels: list[list[Panel]] = []
    selections = {"all leaves (3DGS)": ALL_LEAVES, "cut": SelectOptions(options.pixel_error)}
    for name, select in track(list(selections.items()), "selections"):
        panels.append([])
        unshrunk, base = judge.of_shrinking(select), 1.0
        for way in ways(subject, select, lambda_g=options.lambda_g, loss_db=options.loss_db):
            row = shrinking_row(judge, unshrunk, select, way.options, options.frames)
            image = render(subject.scene, camera, way.options, judge.selector(select)).image
            panels[-1].append(Panel(f"{name}\n{way.name}\n{row['PSNR']:.2f} dB, {row['N_P']:,} pairs", image[window]))
            base = max(number(row, "N_P"), 1.0) if way.options == THREE_SIGMA else base
            rows.append({"selection": name, "shrinking": way.name, **row, "N_P / 3σ": number(row, "N_P") / base})
    return Report(
        "fig5",
        "Ways to end splats: quality, frames a second, pairs",
        {**subject.about, "rules": f"τ_R = {options.pixel_error:g} px, λ_G = {options.lambda_g:g}"},
        [Table("fig5", "Ways to end splats, with and without levels of detail", rows, notes=[ABOUT_LOSS]), paper.FIG5],
        [Grid("fig5_details", "The busiest part of the first view", panels)],
    )
