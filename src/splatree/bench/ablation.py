"""Filters and ways to end splats, each switched on alone: what Tables 2 and 3 have in common."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from splatree.bench.shrinking import EXACT, THREE_SIGMA, Way, calibrated_options
from splatree.bench.subject import Subject, SubjectOptions
from splatree.errors import InputError
from splatree.lod.baselines import BaselineOptions, baseline
from splatree.lod.select import Selector
from splatree.scene.options import SelectOptions

__all__ = ["AblationOptions", "filters", "shrinkings"]


@dataclass(frozen=True)
class AblationOptions:
    """What Tables 2 and 3 are made with."""

    subject: Annotated[SubjectOptions, arg(name="", help="")] = SubjectOptions()
    pixel_error: float = 3.0
    """τ_R, px."""
    lambda_g: float = 0.2
    """λ_G of the paper's shrinking, with τ = λ_G · G as in its code."""
    loss_db: float = 0.1
    """Loss of PSNR that ours may cost, dB."""

    def __post_init__(self) -> None:
        if not self.lambda_g > 0 or not self.loss_db > 0:
            raise InputError(f"lambda_g, loss_db: found {self.lambda_g}, {self.loss_db}, wanted more than 0")


def filters(subject: Subject, options: AblationOptions) -> Iterator[tuple[str, SelectOptions | Selector]]:
    """Three ways to the same cut: level by level, by the paper's table of ancestors, by blocks."""
    methods = BaselineOptions(pixel_error=options.pixel_error)
    yield "serial (LoG)", baseline("serial", subject.scene, options=methods)
    yield "table of ancestors (FilterGS)", baseline("filtergs", subject.scene, options=methods)
    yield "blocks (ours)", SelectOptions(options.pixel_error)


def shrinkings(subject: Subject, options: AblationOptions) -> tuple[Way, ...]:
    """Without shrinking, as the paper's code shrinks, and ours without and with a loss."""
    select = SelectOptions(options.pixel_error)
    release = calibrated_options(subject, select, "release", lambda_g=options.lambda_g)
    target = calibrated_options(subject, select, "target", loss_db=options.loss_db)
    return (
        Way("no: 3σ squares", THREE_SIGMA),
        Way(f"paper's code: τ = {release.threshold:.3g}, squares", release),
        Way("ours, lossless: exact at 1/255", EXACT),
        Way(f"ours, {options.loss_db:g} dB: exact at {target.threshold:.3g}", target),
    )
