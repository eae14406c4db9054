"""Levels by a radius are not written without a word where levels by pairs show the scene much better."""

from dataclasses import replace

from splatree.lod.options import BuildOptions
from splatree.render.trial import FEWEST, try_methods
from splatree.scene.scene import Scene

__all__ = ["CHECKED_FAST", "are_usual", "warnings_of"]

CHECKED_FAST = 15_000
"""Gaussians on which levels by a radius are checked with --fast, in 0.6 CPU-seconds in place of 1.4. Of five scenes that lose
9 dB and more, one goes without a word."""

WORTH_A_WORD_DB = 6.0
"""Levels by a radius that lose so much to pairs, at equal nodes in one picture, are not written without a word."""


def are_usual(options: BuildOptions) -> bool:
    """Whether levels by a radius with the usual rules are asked for; who asks for other rules compares."""
    return replace(options, visibility=True) == BuildOptions(method="radius")


def warnings_of(sample: Scene) -> tuple[str, ...]:
    """A warning if levels by a radius of a sample are much worse than levels by pairs would be."""
    if len(sample) < FEWEST:
        return ()
    trial = try_methods(sample, most=len(sample))
    if trial.radius_loss_db is None or trial.radius_loss_db < WORTH_A_WORD_DB:
        return ()
    return (f"levels by a radius show this scene badly: {trial.in_words()}; wanted --method pairs, or no --method",)
