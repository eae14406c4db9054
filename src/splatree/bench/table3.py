"""Table 3: a filter that is faster but exact changes nothing; a way to end splats changes pairs and, if it is lossy, the picture.

Equal pairs and equal PSNR do not prove equal selections, so the selected rows are compared too, view by view.
"""

from dataclasses import dataclass

import numpy as np

from splatree.bench import paper
from splatree.bench.ablation import AblationOptions, filters, shrinkings
from splatree.bench.experiment import Report, Table
from splatree.bench.measure import Judge
from splatree.bench.shrinking import ABOUT_LOSS
from splatree.bench.subject import subject_of
from splatree.errors import InputError
from splatree.progress import track
from splatree.scene.view import View

__all__ = ["Options", "run"]


@dataclass(frozen=True)
class Options(AblationOptions):
    """Check that filters select the same nodes, and what shrinking does to quality and pairs (FilterGS, Table 3)."""

    frames: int = 0
    """Frames timed for each row, along a path through the views, which adds a column FPS; 0: none are timed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frames < 0:
            raise InputError(f"frames: found {self.frames}, wanted 0 (none are timed) or more")


def run(options: Options) -> Report:
    """Draw the views for each pair of filter and shrinking; compare the rows with those of the traversal."""
    subject = subject_of(options.subject)
    judge = Judge(subject)
    rows, first = [], None
    chosen = shrinkings(subject, options)
    for name, select in track(list(filters(subject, options)), "filters"):
        choose = judge.selector(select)
        selected = [choose(View(camera)).rows for camera in subject.cameras]
        first = first or selected
        same = sum(np.array_equal(a, b) for a, b in zip(first, selected, strict=True))
        for way in chosen:
            found = judge.quality(select, way.options)
            timed = options.frames > 0
            fps = {"FPS": judge.timing(select, way.options, frames=options.frames).fps} if timed else {}
            rows.append(
                {"shrinking": way.name, "filter": name, "PSNR": found.psnr, "SSIM": found.ssim}
                | {"N_P": round(found.num_pairs), "nodes": round(found.num_selected)}
                | {"same rows as serial": f"{same} of {len(selected)} views"}
                | fps
            )
    return Report(
        "table3",
        "Quality and pairs with each part switched on alone",
        {**subject.about, "rules": f"τ_R = {options.pixel_error:g} px"},
        [Table("table3", "Quality, pairs and equality of the selections", rows, notes=[ABOUT_LOSS]), paper.TABLE3],
    )
