"""What changes in the course of a run, as functions of the share p of it that is done, and of the number of the step.

Rates fall log-linearly. Photographs are small at first. The number of Gaussians grows until half of the run, as far as small
photographs can tell so many apart. Each photograph is visited once an epoch, in an order that follows from the seed and the epoch
alone, so a run that stopped goes on alike.

**Minutes.** The clock is read every `ROUND` steps only: what the steps of the last round took says how much p grows with each
step of the next. These numbers are the run's log. With the same log a run gives the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatree.scene.gradients import Moments
from splatree.shapes import Array, Float32
from splatree.train.options import TrainOptions

__all__ = ["ROUND", "LogEntry", "Schedule", "generator", "rates", "round_of"]

ROUND = 100
"""Steps between two readings of the clock, and between two densifications."""

FIRST_ROUND = 10
"""Steps of the first rounds, in which nothing is known of the cost of a step."""

GROWTH_ENDS, BIRTHS_END = 0.5, 0.8
"""Shares of the run at which the number of Gaussians is at its target, and after which none is removed or born."""

PIXELS_EACH = 60
"""Pixels of all training photographs together for each Gaussian, while photographs are smaller than at last. With 25 a long run
learns small photographs by heart, and what is wrong then stays (docs/explanation/train.md, *What was tried*)."""

DEGREES_BEGIN = 0.5
"""Share of the run from which harmonics of degree 2 and 3 are drawn; degree 1 from the beginning."""

ROOTS_LEARN = 0.1
"""Share of the run in which a tree that grows sees photographs of a quarter of the largest size, before all others."""

_RATES = {
    "means": (4e-4, 4e-6),
    "quats": (1e-2, 2e-3),
    "log_scales": (5e-2, 5e-3),
    "logit_opacities": (0.25, 5e-2),
    "dc": (2.5e-2, 2.5e-3),
    "harmonics": (2.5e-3, 2.5e-4),
}
"""Rates at the beginning and at the end, those of the means in extents. Ten times the usual ones, those of the means three times:
runs on a processor have thousands of steps where others have tens of thousands (docs/explanation/train.md, *What was tried*)."""


@dataclass(frozen=True)
class LogEntry:
    """What the clock said at the beginning of a round."""

    step: int
    """Number of its first step, from 0."""
    share: float
    """p at that step."""
    growth: float
    """How much p grows with each step."""
    num_steps: int
    """Steps of the round."""


@dataclass(frozen=True)
class Schedule:
    """What a run does at which share."""

    options: TrainOptions
    """How the scene is trained."""
    finest: int
    """Smallest division of the photographs."""
    coarsest: int
    """Largest division that makes sense of them."""
    num_pixels: int
    """Pixels of all training photographs, undivided."""

    def division(self, share: float) -> int:
        """Division of the photographs."""
        steps = {1: ((0.25, 4), (0.7, 2)), 2: ((0.6, 4),), 4: ((0.25, 8),)}.get(self.finest, ())
        if self.options.levels == "grow":
            steps = ((ROOTS_LEARN, 4 * self.finest), *steps)
        division = next((k for end, k in steps if share < end), self.finest)
        return max(min(division, self.coarsest), self.finest)

    def times_smaller(self, share: float) -> int:
        """How many times smaller photographs are than at last, for the dilation (train/step.py).

        1 where a tree grows: its upper levels are drawn small, with the dilation of large pictures, and learn for that.
        """
        return 1 if self.options.levels == "grow" else self.division(share) // self.finest

    def count_target(self, share: float, num_start: int) -> int:
        """Gaussians that there should be: n0 + (N − n0) min(1, p / ½)^0.8, of which small photographs allow but some."""
        more = self.options.max_gaussians - num_start
        target = int(num_start + more * min(1.0, share / GROWTH_ENDS) ** 0.8)
        division = self.division(share)
        if division == self.finest:
            return target
        return min(target, max(num_start, self.num_pixels // (division**2 * PIXELS_EACH)))

    def sh_degree(self, share: float) -> int:
        """Degree of the harmonics that are drawn."""
        return self.options.degree if share >= DEGREES_BEGIN else min(self.options.degree, 1)

    def view(self, step: int, num_views: int) -> int:
        """The photograph of a step: each comes once in ``num_views`` steps."""
        epoch, place = divmod(step, num_views)
        return int(generator(self.options.seed, "views", epoch).permutation(num_views)[place])


def round_of(
    options: TrainOptions,
    step: int,
    spent_s: float,
    last: LogEntry | None,
    last_s: float,
    replay: Sequence[LogEntry] = (),
) -> LogEntry:
    """The next round.

    Args:
        options: minutes or iterations.
        step: number of its first step.
        spent_s: processor seconds of all steps so far.
        last: the round before; None for the first.
        last_s: processor seconds of that round.
        replay: rounds of an earlier run, which are taken as they are.
    """
    for entry in replay:
        if entry.step == step:
            return entry
    if options.iterations is not None:
        num_steps = min(ROUND, options.iterations - step)
        return LogEntry(step, step / options.iterations, 1 / options.iterations, num_steps)
    assert options.budget_s is not None
    share = spent_s / options.budget_s
    if last is None:
        return LogEntry(step, share, 0.0, FIRST_ROUND)
    growth = max(last_s / last.num_steps / options.budget_s, 1e-9)
    to_next = ROUND - step % ROUND  # so that rounds end where densifications are
    num_steps = min(FIRST_ROUND if step < 3 * FIRST_ROUND else to_next, max(1, int(np.ceil((1 - share) / growth))))
    return LogEntry(step, share, growth, num_steps)


def generator(seed: int, purpose: str, counter: int) -> np.random.Generator:
    """Random numbers of one purpose at one point of a run, whatever was drawn before."""
    key = int.from_bytes(purpose.encode()[:8].ljust(8, b"\0"), "little")
    return np.random.Generator(np.random.Philox(key=[seed, key], counter=[0, 0, 0, counter]))


def rates(share: float, extent: float, moments: Moments, num_coefficients: int) -> Float32[Array, "e"]:
    """Rates of all numbers of a row, in the order of `Moments.values`."""
    p = min(1.0, share)
    now = {name: float(np.exp((1 - p) * np.log(high) + p * np.log(low))) for name, (high, low) in _RATES.items()}
    row = np.zeros(moments.values.shape[2], np.float32)
    row[0:3], row[3:7], row[7:10] = now["means"] * extent, now["quats"], now["log_scales"]
    row[10], row[11:14], row[14 : 11 + 3 * num_coefficients] = now["logit_opacities"], now["dc"], now["harmonics"]
    return row
