"""Figure 7: what the picture loses as τ grows, where it has much detail and where it has little.

The paper raises λ_G until a given share of the pairs below a contribution of 0.01 px is gone; edges of tiles then show on roads
and sand. Squares are drawn as its code draws them, whole inside the tiles that are left; the exact test so too, and tapered.
"""

from dataclasses import dataclass, replace
from typing import Annotated

from tyro.conf import arg

from splatree.bench import paper
from splatree.bench.crops import busiest, calmest
from splatree.bench.experiment import Grid, Panel, Report, Row, Table
from splatree.bench.measure import CONTRIBUTIONS, Judge, number, shrinking_row
from splatree.bench.shrinking import EXACT, SQUARE, THREE_SIGMA
from splatree.bench.subject import SubjectOptions, subject_of
from splatree.errors import InputError
from splatree.progress import track
from splatree.render.contribution import contribution_histogram
from splatree.render.timing import check_frames
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.shapes import Array

__all__ = ["Options", "run"]


@dataclass(frozen=True)
class Options:
    """Show details of the picture as τ grows, with pairs of little contribution, PSNR, FPS (FilterGS, Figure 7)."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions(views=3, size=640)
    pixel_error: float = 3.0
    """τ_R of the cut, px."""
    thresholds: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.4)
    """τ."""
    view: int = 0
    """Which of the views is shown."""
    frames: int = 20
    """Frames timed for each τ, along a path through the views, after as many, at most 20, to warm up."""

    def __post_init__(self) -> None:
        check_frames(self.frames)
        if not all(0 < value < 1 for value in self.thresholds):
            raise InputError(f"thresholds: found {self.thresholds}, wanted numbers between 0 and 1")


def run(options: Options) -> Report:
    """Draw, count and time every τ with three treatments."""
    subject = subject_of(options.subject)
    if not 0 <= options.view < len(subject.cameras):
        raise InputError(f"view: found {options.view}, wanted 0 to {len(subject.cameras) - 1}")
    judge, select = Judge(subject), SelectOptions(options.pixel_error)
    unshrunk = judge.of_shrinking(select)
    treatments = {
        "squares, whole (paper's code)": [THREE_SIGMA, *(replace(SQUARE, threshold=t) for t in options.thresholds)],
        "exact, whole": [EXACT, *(replace(EXACT, threshold=t) for t in options.thresholds)],
        "exact, tapered": [EXACT, *(replace(EXACT, threshold=t, pixels="taper") for t in options.thresholds)],
    }
    rows: list[Row] = []
    grids: dict[str, list[list[Panel]]] = {"high": [], "low": []}
    shown = subject.cameras[options.view].name
    windows = {"high": busiest(judge.references[shown]), "low": calmest(judge.references[shown])}
    for name, drawn in track(list(treatments.items()), "treatments"):
        pictures = []
        for one in drawn:
            row, image = _measured(judge, unshrunk, select, one, options)
            rows.append({"drawn": name + (", 3σ" if one is THREE_SIGMA else ""), **row})
            pictures.append(image)
        for kind, window in windows.items():
            captions = [
                f"{row['drawn']}\nτ = {row['τ']:.3g}, {row['PSNR to unshrunk']:.1f} dB" for row in rows[-len(drawn) :]
            ]
            grids[kind].append([Panel(c, image[window]) for c, image in zip(captions, pictures, strict=True)])
    base = max(number(rows[0], "N_low"), 1.0)
    rows = [{**row, "N_low less %": 100 * (1 - number(row, "N_low") / base)} for row in rows]
    return Report(
        "fig7",
        "Details as τ grows",
        {**subject.about, "rules": f"τ_R = {options.pixel_error:g} px; N_low: pairs with KPC < 0.01 px"},
        [Table("fig7", "Pairs, quality and frames as τ grows; N_low against 3σ squares", rows), paper.FIG7],
        [Grid(f"fig7_{kind}", f"Where the picture has {kind} frequencies", of) for kind, of in grids.items()],
    )


def _measured(
    judge: Judge, unshrunk: Judge, select: SelectOptions, drawn: RenderOptions, options: Options
) -> tuple[Row, Array]:
    """Numbers over all views, and the picture of the one that is shown."""
    frames = [judge.trace(camera, select, drawn, CONTRIBUTIONS) for camera in judge.subject.cameras]
    histogram = contribution_histogram(frame.contributions for frame in frames)
    row = shrinking_row(judge, unshrunk, select, drawn, options.frames)
    return row | {"N_low": round(histogram.num_redundant / len(frames))}, frames[options.view].result.image
