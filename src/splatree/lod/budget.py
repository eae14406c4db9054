"""Meet a budget of nodes by raising τ_R.

Coarser cuts are nested in finer ones, so the number of nodes falls as τ_R grows (but for the few at the border of the
image), about as 1/τ_R² on surfaces: interpolation between the logarithms of two known values finds where it fits.

Where the back end finds the cuts of many τ_R at once, a view alone needs no search. One block of 32 guesses τ_R; one
pass over the cuts nearby finds, for each node, the limits that draw it; the events of these limits, sorted, say how many
nodes each limit draws. The finest of those from which on the budget is kept is taken: it misses the budget by a node or two, for
little more than one cut, and is the same whatever was guessed. The next view of a session is looked for near the τ_R of the last,
without a guess.

Elsewhere a view alone is searched from its finest τ_R, until the cut holds 98 % of the budget or τ_R is known to half a percent:
6 to 8 cuts. The next view of a moving camera begins at the τ_R of the last and is content with 90 %: 1 or 2 cuts.
"""

import math
from collections.abc import Callable, Sized
from typing import Final, Protocol, TypeVar

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.frame.question import pixel_error_of
from splatree.scene.cameras import Camera
from splatree.scene.frame import CutRange
from splatree.scene.options import SelectOptions
from splatree.shapes import Array, Int32

__all__ = ["RangeAt", "fill_budget", "least_limit", "meet_budget", "meet_budget_from", "spread_of"]

LEAST_SPREAD, NOISE = 1.04, 4.0
"""A guess of τ_R from s sampled nodes is taken to be within a factor of 1 + 4 / √s, and the first pass looks there. What was seen
is half of that; beyond it one more pass is made, over a wider range."""

NEAR_SPREAD: Final = 1.02
"""The factor within which τ_R is looked for near that of a view nearby: a camera that moves by 1 % changes it by about as much.
What is found is not taken in the last quarter before the coarsest limit: just beyond, cuts might exceed the budget again."""

LEAST_PX: Final = 0.05
"""Least τ_R that is stepped to; a finer one that is wanted is taken at once."""

FIRST_COARSEST_PX: Final = 128.0
"""Where the first guess ends: a budget that needs coarser cuts takes one more pass."""

BUDGET_SHARE: Final = 0.98
"""A selection that holds this share of its budget is not refined further."""

NEXT_SHARE: Final = 0.9
"""The same where the search begins at the τ_R of the view before: what a step of the camera changes is of this order."""

NEXT_AIM: Final = 0.95
"""The share that such a search aims at: the middle of what it accepts."""

FAR_FROM_LAST: Final = 16
"""With this many times the budget the view has nothing in common with the last: it is searched like a view alone."""

BUDGET_PRECISION: Final = 1.005
"""Nor is one whose τ_R is known to this factor; near the border of the image counts may jump by more than 2 %."""

LARGEST_LIMIT: Final = 3e38
"""Beyond any limit: what is drawn up to the coarsest limit leaves here."""

COARSEST_PX: Final = 2.0**24
"""Largest finite τ_R that a budget tries: beyond any image. Only nodes that reach behind the near plane are larger: infinite."""

Rows = TypeVar("Rows", bound=Sized)
"""Rows of a selection: an array, or where they are (outofcore/paging.py)."""


class RangeAt(Protocol):
    """The cuts of all τ_R from ``finest`` to ``coarsest``, px; of ``every`` so many blocks of rows one is looked at."""

    def __call__(self, finest: float, coarsest: float, every: int = 1) -> CutRange: ...


def fill_budget(
    range_at: RangeAt,
    rows_at: Callable[[float], tuple[Int32[Array, "v"], int]],
    options: SelectOptions,
    finest: float,
    camera: Camera,
    *,
    every: int,
    near: float | None = None,
) -> tuple[Int32[Array, "v"], int, float]:
    """The rows of the finest τ_R from which on the budget is kept, how many were looked at, and this τ_R, px.

    Args:
        range_at: the cuts of a range of τ_R.
        rows_at: the selection at one, px.
        options: with a budget, and with the profile of the levels.
        finest: finest τ_R that is wanted, px.
        camera: the view, named in the error.
        every: of so many blocks one is looked at for a guess; 1: all of them at once, they are few.
        near: where τ_R is looked for first, px; None: guessed. It changes what is looked at, and not what is found.

    Raises:
        InputError: not even the roots in view meet the budget.
    """
    budget, profile = options.budget or 1, options.resolved_profile
    fine, coarse = finest, max(finest, FIRST_COARSEST_PX)
    if near is not None and (found_near := _filled_near(range_at, options, finest, near)) is not None:
        return found_near
    spread = spread_of(budget, every)
    if every > 1:
        guess = least_limit(range_at(fine, coarse, every), budget / every)
        if guess is not None:
            middle = max(finest, pixel_error_of(guess, profile))
            fine, coarse = max(finest, middle / spread), middle * spread
    while True:
        found = range_at(fine, coarse)
        limit = least_limit(found, budget)
        spread *= spread
        if limit is None:  # too many nodes: go coarser
            if coarse >= COARSEST_PX:  # what is left is refined at any finite τ_R: it reaches behind the near plane
                rows, visited = rows_at(np.inf)
                _check_roots(len(rows), budget, camera)
                return rows, visited, np.inf
            fine, coarse = coarse, min(COARSEST_PX, max(coarse, LEAST_PX) * spread)
        elif limit == 0 and fine > finest:  # room is left: go finer
            finer = fine / spread
            fine, coarse = finer if finer > max(finest, LEAST_PX) else finest, fine
        elif limit == 0:
            return found.at(0), found.num_visited, finest
        else:
            return found.at(limit), found.num_visited, pixel_error_of(limit, profile)


def spread_of(budget: int, every: int) -> float:
    """The factor within which the τ_R of a budget is taken to be, if it was guessed from one of ``every`` blocks."""
    return max(LEAST_SPREAD, 1 + NOISE * math.sqrt(every / budget))


def _filled_near(
    range_at: RangeAt, options: SelectOptions, finest: float, near: float
) -> tuple[Int32[Array, "v"], int, float] | None:
    """What `fill_budget` finds, if it lies near a τ_R, px."""
    budget = options.budget or 1
    spread = max(NEAR_SPREAD, 1 + NOISE / math.sqrt(budget))
    fine, coarse = max(finest, near / spread), max(finest, near) * spread
    if not math.isfinite(coarse) or near < LEAST_PX:
        return None
    found = range_at(fine, coarse)
    limit = least_limit(found, budget)
    if limit is None or (limit == 0 and fine > finest):
        return None
    pixel_error = finest if limit == 0 else pixel_error_of(limit, options.resolved_profile)
    if pixel_error * (1 + (spread - 1) / 4) > coarse:
        return None
    return found.at(limit), found.num_visited, pixel_error


def least_limit(found: CutRange, budget: float) -> float | None:
    """The least limit from which on all limits of a range draw at most ``budget`` rows; 0 if all do; None if none does."""
    # The bits of positive float32 are ordered as they are. Down from a size, the node is not drawn and what it stands for is.
    ends, begins = found.leaves[found.leaves < LARGEST_LIMIT], found.enters[found.enters > 0]
    count = len(found.rows) - len(ends)
    if count > budget:
        return None
    events = np.sort(np.concatenate([ends.view(np.uint32) << 1 | 1, begins.view(np.uint32) << 1]))[::-1]
    sizes = events >> 1
    counts = count + np.cumsum(2 * (events & 1).astype(np.int64) - 1)
    over = np.flatnonzero((counts > budget) & np.append(sizes[1:] != sizes[:-1], True)[: len(sizes)])
    return float(sizes[over[0]].view(np.float32)) if len(over) else 0.0


def meet_budget(
    rows_at: Callable[[float], tuple[Rows, int]], budget: int, finest: float, num_finest: int, camera: Camera
) -> tuple[Rows, int, float]:
    """Rows at a τ_R above ``finest``, where there are too many, whose number is just within the budget.

    Raises:
        InputError: not even the roots in view meet it.
    """
    fine, num_fine = finest, num_finest
    coarse = max(finest, 0.1)
    found: tuple[Rows, int]
    while coarse < COARSEST_PX:
        coarse *= max(2.0, float(np.sqrt(num_fine / budget)))
        found = rows_at(coarse)
        if len(found[0]) <= budget:
            break
        if fine == finest:
            _check_roots(len(rows_at(np.inf)[0]), budget, camera)
        fine, num_fine = coarse, len(found[0])
    else:
        return *rows_at(np.inf), np.inf  # what is left is refined at any finite τ_R: it reaches behind the near plane

    wanted = (1 + BUDGET_SHARE) / 2 * budget
    while coarse > BUDGET_PRECISION * max(fine, 1e-3) and len(found[0]) < BUDGET_SHARE * budget:
        drop = np.log(num_fine / max(len(found[0]), 1))
        share = np.clip(np.log(num_fine / wanted) / drop, 0.1, 0.9)
        middle = float(max(fine, coarse / 16) ** (1 - share) * coarse**share)
        between = rows_at(middle)
        if len(between[0]) <= budget:
            coarse, found = middle, between
        else:
            fine, num_fine = middle, len(between[0])
    return *found, float(coarse)


def meet_budget_from(
    rows_at: Callable[[float], tuple[Rows, int]], budget: int, bounds: tuple[float, float], last: float, camera: Camera
) -> tuple[Rows, int, float]:
    """Rows at the finest τ_R, or at a coarser one if these are more than the budget; the search begins at ``last``.

    The rows are at most ``budget``; they are at least 90 % of it, unless τ_R is the finest or known to half a percent.

    Args:
        rows_at: the selection at a τ_R, px.
        budget: most nodes that are wanted.
        bounds: finest τ_R that is wanted, and the τ_R below which only leaves are drawn, px.
        last: τ_R that met the budget in a view nearby, px; infinity or what is below the finest is taken as the finest.
        camera: the view, named in the error.

    Raises:
        InputError: not even the roots in view meet the budget.
    """
    finest, only_leaves = bounds
    tau = last if np.isfinite(last) and last > finest else finest
    fine: tuple[float, int] | None = None  # a τ_R with too many nodes, and how many
    coarse: tuple[float, int] | None = None  # a τ_R with at most the budget
    found: tuple[Rows, int]  # of coarse
    while True:
        tried = rows_at(tau)
        count = len(tried[0])
        if count > budget:
            fine = tau, count
        else:
            coarse, found = (tau, count), tried
            if tau <= finest or count >= NEXT_SHARE * budget:
                return *found, tau
        if fine is None and coarse is not None:  # room is left: go finer
            tau = max(finest, coarse[0] * min(0.98, float(np.sqrt(coarse[1] / (NEXT_AIM * budget)))))
            tau = finest if tau < max(only_leaves, 0.05) else tau
        elif fine is not None and coarse is None:  # too many: go coarser
            tau = max(fine[0], 0.1) * max(1.02, float(np.sqrt(fine[1] / (NEXT_AIM * budget))))
            if tau > COARSEST_PX or fine[1] > FAR_FROM_LAST * budget:
                return meet_budget(rows_at, budget, fine[0], fine[1], camera)
        elif fine is not None and coarse is not None:  # between two that are known
            if coarse[0] <= BUDGET_PRECISION * max(fine[0], 1e-3):
                return *found, coarse[0]
            drop = np.log(fine[1] / max(coarse[1], 1))
            share = float(np.clip(np.log(fine[1] / (NEXT_AIM * budget)) / drop, 0.1, 0.9))
            tau = float(max(fine[0], coarse[0] / 16) ** (1 - share) * coarse[0] ** share)


def _check_roots(num_roots: int, budget: int, camera: Camera) -> None:
    if num_roots > budget:
        raise InputError(
            f"budget: found {num_roots} roots in view of camera {camera.name!r}, wanted at most {budget} nodes; "
            f"build levels with fewer roots or allow more nodes"
        )
