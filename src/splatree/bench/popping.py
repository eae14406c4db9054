"""Popping: how much the picture jumps where levels switch, on slow dollies through a scene.

Each frame is drawn with its own cut and with that of the frame before (render/popping.py). The motion of the camera is in both
pictures, so their difference is the pop alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from tyro.conf import arg

from splatree.bench.experiment import Curve, Plot, Report, Row, Table
from splatree.bench.subject import SubjectOptions, subject_of
from splatree.errors import InputError
from splatree.render.popping import Pop, dolly, measure_pops
from splatree.scene.options import SelectOptions

__all__ = ["Options", "run"]

ABOUT = (
    "PSNR of a pop: the frame's own cut against the cut before, both from the frame's camera; 100 dB stands for 100 and more.",
    "changed: pixels of which a channel changes by more than 4/255. tile: largest mean change of 16 × 16 px, 0 to 1.",
)


@dataclass(frozen=True)
class Options:
    """Measure how much the picture jumps where levels switch: slow dollies from the views, each frame against the cut before."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions(views=3)
    frames: int = 12
    """Frames of each dolly."""
    step: float = 0.01
    """Share of the distance to what is looked at that the camera covers from one frame to the next; negative: it moves back."""
    pixel_error: float = SelectOptions().pixel_error
    """τ_R of the cuts, px."""
    budget: int | None = None
    """Largest number of nodes in view; None: no limit."""
    quality: float | None = None
    """PSNR against all leaves of the first frame of each dolly, dB, whose τ_R is kept, in place of a pixel error."""

    def __post_init__(self) -> None:
        if self.frames < 2:
            raise InputError(f"frames: found {self.frames}, wanted at least 2")
        if not -1 < self.step < 1 or self.step == 0:
            raise InputError(f"step: found {self.step:g}, wanted a share of the distance between -1 and 1, not 0")
        SelectOptions(self.pixel_error, self.budget, self.quality)


def run(options: Options) -> Report:
    """Move from each view towards what it looks at, and measure the pop of each frame."""
    subject = subject_of(options.subject)
    select = SelectOptions(options.pixel_error, options.budget, options.quality)
    pops = {
        camera.name or str(i): measure_pops(
            subject.scene, dolly(subject.scene, camera, options.frames, step=options.step), select
        )
        for i, camera in enumerate(subject.cameras)
    }
    limit = "" if options.budget is None else f", at most {options.budget:,} nodes in view"
    size = f"τ_R = {options.pixel_error:g} px" if options.quality is None else f"τ_R of {options.quality:g} dB"
    about = {
        **subject.about,
        "compared with": "the cut of the frame before, drawn from the frame's camera",
        "rules": f"{size}{limit}; {options.frames} frames a dolly, steps of {options.step:.3g}",
    }
    tables = [
        Table("popping", "Pops of each dolly", [_summary(name, found) for name, found in pops.items()], notes=ABOUT),
        Table("popping_frames", "Pops of each frame", [_row(pop) for found in pops.values() for pop in found]),
    ]
    curves = [
        Curve(name, list(range(1, len(found) + 1)), [_shown(pop.psnr) for pop in found]) for name, found in pops.items()
    ]
    plot = Plot("popping", "Pops of slow dollies", "frame", "PSNR of the pop, dB", curves)
    return Report("popping", "How much the picture jumps where levels switch", about, tables, [plot])


def _summary(name: str, pops: Sequence[Pop]) -> Row:
    worst = max(pops, key=lambda pop: pop.tile_change)
    return {
        "dolly": name,
        "PSNR": _shown(float(-10 * np.log10(np.mean([10 ** (-pop.psnr / 10) for pop in pops]) or 1e-10))),
        "worst PSNR": _shown(min(pop.psnr for pop in pops)),
        "worst changed %": 100 * max(pop.changed for pop in pops),
        "worst pixel": max(pop.pixel_change for pop in pops),
        "worst tile": worst.tile_change,
        "where": f"{worst.camera} at {worst.tile_px[0]}, {worst.tile_px[1]} px",
        "nodes": round(float(np.mean([pop.num_nodes for pop in pops]))),
        "switched": round(float(np.mean([pop.num_switched for pop in pops]))),
    }


def _row(pop: Pop) -> Row:
    return {
        "frame": pop.camera,
        "PSNR": _shown(pop.psnr),
        "changed %": 100 * pop.changed,
        "pixel": pop.pixel_change,
        "tile": pop.tile_change,
        "tile x": pop.tile_px[0],
        "tile y": pop.tile_px[1],
        "nodes": pop.num_nodes,
        "switched": pop.num_switched,
    }


def _shown(psnr: float) -> float:
    return min(psnr, 100.0)
