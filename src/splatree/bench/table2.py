"""Table 2: where a frame's time goes, with and without shrinking, for three filters that select the same nodes.

The paper's stages are ours as the head of render/timing.py says; T_synch, the wait for the host between levels, does not arise
on a processor that does all the work itself.
"""

from dataclasses import dataclass

from splatree.bench import paper
from splatree.bench.ablation import AblationOptions, filters, shrinkings
from splatree.bench.experiment import Report, Table
from splatree.bench.measure import Judge
from splatree.bench.shrinking import ABOUT_LOSS
from splatree.bench.subject import subject_of
from splatree.progress import track
from splatree.render.timing import STAGES, Timing, check_frames

__all__ = ["Options", "run"]


@dataclass(frozen=True)
class Options(AblationOptions):
    """Time the stages of a frame with each filter and each way to shrink (FilterGS, Table 2)."""

    frames: int = 40
    """Frames timed for each row, along a path through the views, after as many, at most 20, to warm up."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_frames(self.frames)


def run(options: Options) -> Report:
    """Time a path through the views for each pair of filter and shrinking."""
    subject = subject_of(options.subject)
    judge = Judge(subject)
    rows: list[dict[str, object]] = []
    chosen = shrinkings(subject, options)
    for name, select in track(list(filters(subject, options)), "filters"):
        for way in chosen:
            timing = judge.timing(select, way.options, frames=options.frames)
            rows.append({"shrinking": way.name, "filter": name} | _columns(timing))
    rules = f"τ_R = {options.pixel_error:g} px; means of {options.frames} frames; no T_synch: nothing waits for a host"
    return Report(
        "table2",
        "Where a frame's time goes, CPU-ms",
        {**subject.about, "rules": rules},
        [
            Table(
                "table2", "CPU-ms of each stage a frame, all threads together, and its share", rows, notes=[ABOUT_LOSS]
            ),
            paper.TABLE2,
        ],
    )


def _columns(timing: Timing) -> dict[str, object]:
    stages = {name: timing.cpu_ms[stage] for name, stage in STAGES.items()}
    shares = {f"{name} %": 100 * ms / timing.frame_cpu_ms for name, ms in stages.items()}
    total = {"T_total": timing.frame_cpu_ms, "wall ms": timing.frame_ms, "FPS": timing.fps}
    return {**stages, **total, **shares, "N_P": round(timing.num_pairs)}
