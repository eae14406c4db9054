"""Meet a budget of nodes by raising τ_R.

Coarser cuts are nested in finer ones, so the number of nodes falls as τ_R grows (but for the few at the border of the
image), about as 1/τ_R² on surfaces: interpolation between the logarithms of two known values finds where it fits.

A view alone is searched from its finest τ_R, until the cut holds 98 % of the budget or τ_R is known to half a percent: 6 to 8
cuts. The next view of a moving camera begins at the τ_R of the last and is content with 90 %: 1 or 2 cuts.
"""

from collections.abc import Callable, Sized
from typing import Final, TypeVar

import numpy as np

from splatree.errors import InputError
from splatree.scene.cameras import Camera

__all__ = ["meet_budget", "meet_budget_from"]

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

COARSEST_PX: Final = 2.0**24
"""Largest finite τ_R that a budget tries: beyond any image. Only nodes that reach behind the near plane are larger: infinite."""

Rows = TypeVar("Rows", bound=Sized)
"""Rows of a selection: an array, or where they are (outofcore/paging.py)."""


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
