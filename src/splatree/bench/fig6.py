"""Figure 6: (a) quality against frames and pairs as shrinking grows; (b) what the pairs contribute, with and without it.

The paper sweeps λ_G. Here λ_G is swept in both of its readings, τ itself for the exact test, and for ours the loss that is
allowed. Each ends in a τ, so all lie in one plane of PSNR over N_P, where the better one is above and to the left.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from tyro.conf import arg

from splatree.bench import paper
from splatree.bench.experiment import Curve, Plot, Report, Row, Table
from splatree.bench.measure import CONTRIBUTIONS, Judge, number, shrinking_row
from splatree.bench.shrinking import ABOUT_LOSS, EXACT, THREE_SIGMA, Way, calibrated_options
from splatree.bench.subject import Subject, SubjectOptions, subject_of
from splatree.errors import InputError
from splatree.progress import track
from splatree.render.calibration import Policy
from splatree.render.contribution import ContributionHistogram, contribution_histogram
from splatree.render.timing import check_frames
from splatree.scene.options import RenderOptions, SelectOptions

__all__ = ["Options", "run"]

LOW_PX = 0.05
"""Contribution below which the paper counts pairs in Figure 6 (b), px."""


@dataclass(frozen=True)
class Options:
    """Sweep λ_G, τ and the allowed loss: PSNR, FPS, N_P; and the histogram of contributions (FilterGS, Figure 6)."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions(views=4)
    pixel_error: float = 3.0
    """τ_R of the cut, px."""
    lambdas: tuple[float, ...] = (0.03, 0.1, 0.2, 0.4)
    """λ_G of the sweep, for the paper's text and for its code."""
    thresholds: tuple[float, ...] = (0.01, 0.03, 0.1, 0.2)
    """τ of the sweep of the exact test, with both treatments of the pixels."""
    losses_db: tuple[float, ...] = (0.05, 0.1, 0.3)
    """Losses of PSNR allowed to ours, dB."""
    frames: int = 20
    """Frames timed for each point, along a path through the views, after as many, at most 20, to warm up."""

    def __post_init__(self) -> None:
        check_frames(self.frames)
        for name in ("lambdas", "thresholds", "losses_db"):
            if not all(value > 0 for value in getattr(self, name)):
                raise InputError(f"{name}: found {getattr(self, name)}, wanted numbers above 0")


def run(options: Options) -> Report:
    """Draw and time every point of the sweep; count what pairs contribute for four of them."""
    subject = subject_of(options.subject)
    judge, select = Judge(subject), SelectOptions(options.pixel_error)
    unshrunk = judge.of_shrinking(select)
    rows: list[Row] = []
    for rule, parameter, drawn in track(list(_sweep(subject, select, options)), "sweep"):
        row = shrinking_row(judge, unshrunk, select, drawn, options.frames)
        rows.append({"rule": rule, "parameter": parameter, **row})
    base = max(number(rows[0], "N_P"), 1.0)
    rows = [{**row, "N_P / 3σ": number(row, "N_P") / base} for row in rows]
    histograms = {way.name: _histogram(judge, select, way.options) for way in _counted(subject, select)}
    return Report(
        "fig6",
        "Quality, frames and pairs as shrinking grows; what the pairs contribute",
        {**subject.about, "rules": f"τ_R = {options.pixel_error:g} px; each point over {options.frames} frames"},
        [
            Table("fig6_sweep", "Each rule over its parameter", rows, notes=[ABOUT_LOSS]),
            Table("fig6_contributions", "What pairs contribute", [_shares(*item) for item in histograms.items()]),
            paper.FIG7,
        ],
        [_frontier(rows), *_over_lambda(rows), _distribution(histograms)],
    )


def _sweep(subject: Subject, select: SelectOptions, options: Options) -> Iterator[tuple[str, str, RenderOptions]]:
    yield "3σ squares", "", THREE_SIGMA
    readings: dict[Policy, str] = {"paper": "λ_G / G squares (paper's text)", "release": "λ_G · G squares (its code)"}
    for policy, name in readings.items():
        for value in options.lambdas:
            yield name, f"λ_G = {value:g}", calibrated_options(subject, select, policy, lambda_g=value)
    for pixels in ("hard", "taper"):
        for value in options.thresholds:
            yield f"exact, {pixels}", f"τ = {value:g}", replace(EXACT, threshold=value, pixels=pixels)
    yield "target (ours)", "0 dB: τ = 1/255", EXACT
    for value in options.losses_db:
        yield "target (ours)", f"{value:g} dB", calibrated_options(subject, select, "target", loss_db=value)


def _counted(subject: Subject, select: SelectOptions) -> Sequence[Way]:
    return (
        Way("3σ squares", THREE_SIGMA),
        Way("λ_G · G squares, λ_G = 0.2", calibrated_options(subject, select, "release")),
        Way("1/255 exact (ours)", EXACT),
        Way("target 0.1 dB (ours)", calibrated_options(subject, select, "target")),
    )


def _histogram(judge: Judge, select: SelectOptions, options: RenderOptions) -> ContributionHistogram:
    frames = (judge.trace(camera, select, options, CONTRIBUTIONS) for camera in judge.subject.cameras)
    return contribution_histogram(frame.contributions for frame in frames)


def _shares(name: str, histogram: ContributionHistogram) -> Row:
    low = int(histogram.counts[histogram.edges_px[1:] <= LOW_PX].sum())
    return {
        "drawn": name,
        "pairs of all views": histogram.num_pairs,
        "used %": 100 * histogram.used_ratio,
        "KPC < 0.01 %": 100 * histogram.redundant_ratio,
        "KPC < 0.01": histogram.num_redundant,
        "KPC < 0.05": low,
        "KPC >= 1": int(histogram.counts[histogram.edges_px[:-1] >= 1].sum()),
    }


def _numbers(rows: Sequence[Row], column: str) -> list[float]:
    return [number(row, column) for row in rows]


def _rules(rows: Sequence[Row]) -> dict[str, list[Row]]:
    names = dict.fromkeys(str(row["rule"]) for row in rows)
    return {name: [row for row in rows if row["rule"] == name] for name in names}


def _frontier(rows: Sequence[Row]) -> Plot:
    curves = [Curve(rule, _numbers(of, "N_P"), _numbers(of, "PSNR to unshrunk")) for rule, of in _rules(rows).items()]
    return Plot("fig6_frontier", "Loss by shrinking over pairs", "N_P", "PSNR to the unshrunk picture, dB", curves)


def _over_lambda(rows: Sequence[Row]) -> Iterator[Plot]:
    """The paper's rules, here and there, over λ_G, as Figure 6 (a) is drawn; each as a change from its first point."""
    units = {
        "PSNR": "PSNR less that of the first point, dB",
        "FPS": "FPS over that of the first point; here by processor time",
    }
    for column, unit in units.items():
        curves = []
        for rule, of in _rules(rows).items():
            if "λ_G" not in rule:
                continue
            x = [float(str(row["parameter"]).removeprefix("λ_G = ")) for row in of]
            y = _numbers(of, "PSNR") if column == "PSNR" else [1e3 / number(row, "frame CPU-ms") for row in of]
            curves.append(Curve(rule, x, _relative(y, column)))
        theirs = [replace(curve, y=_relative(curve.y, column)) for curve in paper.fig6_curves(column)]
        yield Plot(f"fig6_{column.lower()}", f"{column} over λ_G", "λ_G", unit, [*curves, *theirs], log_x=True)


def _relative(values: Sequence[float], column: str) -> list[float]:
    return [value - values[0] if column == "PSNR" else value / values[0] for value in values]


def _distribution(histograms: dict[str, ContributionHistogram]) -> Plot:
    curves = []
    for name, histogram in histograms.items():
        middle = np.sqrt(np.maximum(histogram.edges_px[:-1], histogram.edges_px[1] / 2) * histogram.edges_px[1:])
        curves.append(Curve(name, middle.tolist(), np.maximum(histogram.counts, 1).tolist()))
    return Plot(
        "fig6_histogram", "Pairs by contribution", "KPC, px", "pairs in the bin", curves, log_x=True, log_y=True
    )
