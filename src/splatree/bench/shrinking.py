"""The ways to end a splat that the experiments set side by side: what the paper says, what its code does, what others do, ours.

Each is a `RenderOptions`; τ is calibrated on the training views with the selection that will be drawn, never on photographs of
the views that are scored.
"""

from dataclasses import dataclass, replace

from splatree.bench.subject import Subject
from splatree.constants import ALPHA_THRESHOLD
from splatree.render.calibrate import calibrate
from splatree.render.calibration import CalibrateOptions, Policy
from splatree.scene.options import RenderOptions, SelectOptions

__all__ = ["ABOUT_LOSS", "BALANCED", "EXACT", "SQUARE", "THREE_SIGMA", "Way", "calibrated_options", "ways"]

THREE_SIGMA = RenderOptions(tile_rule="3sigma", threshold=ALPHA_THRESHOLD)
"""Squares of 3 σ (Kerbl 2023)."""
SQUARE = RenderOptions(tile_rule="tau", threshold=ALPHA_THRESHOLD)
"""Squares that end at τ, at most 3 σ (FilterGS; it takes τ = 1/255 for the rule of FlashGS)."""
EXACT = RenderOptions(tile_rule="ellipse", threshold=ALPHA_THRESHOLD)
"""Exact test of tiles at 1/255: draws what evaluating every pixel draws. So does FlashGS's own code, at 1/256."""
BALANCED = RenderOptions(tile_rule="balanced", threshold=ALPHA_THRESHOLD)
"""Exact test, at less than τ for large splats."""

ABOUT_LOSS = (
    "A loss of x dB without photographs is that of a scene which is itself 30 dB from the truth (render/calibrate.py)."
)


@dataclass(frozen=True)
class Way:
    """A named way to end splats."""

    name: str
    """As in the tables."""
    options: RenderOptions
    """How it is drawn."""


def ways(subject: Subject, select: SelectOptions, *, lambda_g: float, loss_db: float) -> tuple[Way, ...]:
    """All of them for one selection, from what 3DGS does to ours."""
    return (
        Way("3σ square (3DGS)", THREE_SIGMA),
        Way("1/255 square", SQUARE),
        Way("λ_G / G square (paper's text)", calibrated_options(subject, select, "paper", lambda_g=lambda_g)),
        Way("λ_G · G square (its code)", calibrated_options(subject, select, "release", lambda_g=lambda_g)),
        Way("1/255 exact (ours, lossless)", EXACT),
        Way(f"target {loss_db:g} dB exact (ours)", calibrated_options(subject, select, "target", loss_db=loss_db)),
    )


def calibrated_options(
    subject: Subject, select: SelectOptions, policy: Policy, *, lambda_g: float = 0.2, loss_db: float = 0.1
) -> RenderOptions:
    """τ by a policy: squares, and G over the lists of 3σ squares, for the paper's two; for ours the exact test, balanced."""
    theirs = policy in ("paper", "release")
    drawn = SQUARE if theirs else BALANCED
    rules = CalibrateOptions(policy, loss_db=loss_db, lambda_g=lambda_g, lists="3sigma" if theirs else "ellipse")
    found = calibrate(subject.scene, subject.training, rules, drawn, select, photos=subject.training_photos)
    return replace(drawn, threshold=found.threshold)
