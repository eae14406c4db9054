"""Births where pictures are wrong, to an exact number of Gaussians, and removal of what nothing shows.

Over the steps since the last time, each row gathers the error where it was drawn, E = Σ T α |error| over views and pixels, and
the largest weight W = Σ T α that it had in a view. Rows to divide are drawn without replacement, with probabilities in
proportion to E. A row is divided once, along its longest axis:

    centre ± 0.7 σ,   σ → 0.714 σ,   opacity → (1 − √(1 − o)) / 0.619

which keeps the second moment along that axis (0.7² + 0.714² = 1) and the opacity at the old centre, where each half is worth
0.619 = exp(−½ (0.7 / 0.714)²). Moments and steps of both halves begin anew. A row that no view saw is never removed for that.

Where a tree grows (train/lineage.py), a row gets children instead of being divided, once it has learned for `GROWN_UP` steps.

Rows then stand along a Morton curve again: what lies together is read together.
"""

from dataclasses import dataclass, fields

import numpy as np

from splatree.maths.morton import morton_codes
from splatree.maths.rotations import matrices_from_quats
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import Moments, SplatGradients
from splatree.shapes import Array, Bool, Float32, Float64, Int32, check_fields
from splatree.train.lineage import CHILDREN, Lineage, children_of

__all__ = ["Rows", "Sightings", "along_curve", "densified", "split"]

OFFSET, NARROWING, CENTRE = 0.7, 0.714, 0.619
"""Centres of the halves and their σ, in σ; what each half is worth at the old centre."""

OPACITY_MIN = 0.005
"""Fainter rows are removed."""

WEIGHT_MIN_PX, WEIGHT_TO_SPLIT_PX = 0.02, 2.0
"""Rows that were seen and never covered the one are removed; those that covered the other in some view may be divided."""

LARGEST_EXTENTS = 0.5
"""Rows of a larger σ, in extents, are removed."""

SPLIT_OPACITY_MAX = 0.98

GROWN_UP = 50
"""Steps of its own that a row has made before it gets children: it stays for ever as it is then."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """What each row was seen to do since the last densification; arrays change in place."""

    errors: Float64[Array, "n"]
    """E: sum of T α times the error, over pixels and views."""
    weights: Float32[Array, "n"]
    """W: the largest sum of T α in a view, px; −1 for rows that were in no view."""

    def __post_init__(self) -> None:
        check_fields(self)

    @staticmethod
    def none(num_rows: int) -> "Sightings":
        """Of rows that no view has seen."""
        return Sightings(np.zeros(num_rows), np.full(num_rows, -1, np.float32))

    def add(self, rows: Int32[Array, "v"], gradients: SplatGradients) -> None:
        """Add a view."""
        assert gradients.errors is not None and gradients.weights is not None
        self.errors[rows] += gradients.errors
        self.weights[rows] = np.maximum(self.weights[rows], gradients.weights)


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of a run with what belongs to them."""

    gaussians: Gaussians
    """The scene as it is."""
    moments: Moments
    """What the optimiser remembers."""
    lineage: Lineage | None = None
    """Whose children they are, where a tree grows; None: rows are divided and leave nothing behind."""

    def take(self, rows: Array) -> "Rows":
        """These rows, copied."""
        lineage = None if self.lineage is None else self.lineage.take(rows)
        return Rows(self.gaussians.take(rows), Moments(self.moments.values[rows], self.moments.steps[rows]), lineage)

    @staticmethod
    def beginning(gaussians: Gaussians) -> "Rows":
        """Rows that have made no step."""
        return Rows(gaussians, Moments.zeros(len(gaussians), gaussians.sh.shape[1]))


def densified(rows: Rows, seen: Sightings, target: int, extent: float, rng: np.random.Generator) -> Rows:
    """The rows with weak ones removed and wrong ones divided, at most ``target`` of them, along a Morton curve."""
    kept = _worth_keeping(rows.gaussians, seen, extent)
    if not kept.any():  # a run that has learned nothing yet keeps what it has
        kept[:] = True
    rows, errors, weights = rows.take(kept), seen.errors[kept], seen.weights[kept]
    may_split, more = (weights > WEIGHT_TO_SPLIT_PX) & (errors > 0), 1
    if rows.lineage is not None:
        may_split, more = may_split & (rows.moments.steps >= GROWN_UP), CHILDREN - 1
    num_births = max(0, min((target - len(errors)) // more, len(errors) // 2, int(may_split.sum())))
    if num_births:
        rows = _born(rows, _drawn(errors, may_split, num_births, rng))
    return rows.take(along_curve(rows.gaussians))


def split(gaussians: Gaussians) -> tuple[Gaussians, Gaussians]:
    """Both halves of each row."""
    n = np.arange(len(gaussians))
    longest = np.argmax(gaussians.log_scales, axis=1)
    axis = matrices_from_quats(gaussians.quats)[n, :, longest]  # [n 3], columns are the axes of the Gaussian
    shift = OFFSET * np.exp(gaussians.log_scales[n, longest].astype(np.float64))[:, None] * axis
    log_scales = gaussians.log_scales.copy()
    log_scales[n, longest] += np.float32(np.log(NARROWING))
    opacity = np.clip((1 - np.sqrt(1 - gaussians.opacities())) / CENTRE, OPACITY_MIN, SPLIT_OPACITY_MAX)
    logits = np.log(opacity / (1 - opacity)).astype(np.float32)
    first, second = (
        Gaussians(
            (gaussians.means + sign * shift).astype(np.float32), gaussians.quats, log_scales, logits, gaussians.sh
        )
        for sign in (1, -1)
    )
    return first, second


def along_curve(gaussians: Gaussians) -> Array:
    """Rows in the order of the Morton codes of their means."""
    return np.argsort(morton_codes(gaussians.means), kind="stable")


def _worth_keeping(gaussians: Gaussians, seen: Sightings, extent: float) -> Bool[Array, "n"]:
    finite = np.logical_and.reduce(
        [np.isfinite(getattr(gaussians, f.name).reshape(len(gaussians), -1)).all(axis=1) for f in fields(gaussians)]
    )
    with np.errstate(over="ignore", invalid="ignore"):
        large = np.exp(gaussians.log_scales.max(axis=1)) > LARGEST_EXTENTS * extent
        faint = gaussians.opacities() < OPACITY_MIN
    hidden = (seen.weights >= 0) & (seen.weights < WEIGHT_MIN_PX)
    return np.asarray(finite & ~(large | faint | hidden))


def _drawn(errors: Array, may_split: Array, count: int, rng: np.random.Generator) -> Array:
    """Rows, without replacement, with probabilities in proportion to the errors (Gumbel keys: Efraimidis 2006)."""
    with np.errstate(divide="ignore"):
        keys = np.where(may_split, np.log(errors), -np.inf) + rng.gumbel(size=len(errors))
    return np.sort(np.argpartition(-keys, count - 1)[:count])


def _born(rows: Rows, chosen: Array) -> Rows:
    """The rows with the chosen ones divided: one part in the place of each, the others at the end."""
    parents, lineage = rows.gaussians.take(chosen), rows.lineage
    if lineage is None:
        first, *others = split(parents)
    else:
        first, *others = children_of(parents)
        lineage = lineage.grown(parents, chosen)
    for field in fields(Gaussians):
        getattr(rows.gaussians, field.name)[chosen] = getattr(first, field.name)
    rows.moments.values[chosen], rows.moments.steps[chosen] = 0, 0
    fresh = Rows.beginning(Gaussians.concatenate(others))
    return Rows(
        Gaussians.concatenate([rows.gaussians, fresh.gaussians]),
        Moments(
            np.concatenate([rows.moments.values, fresh.moments.values]),
            np.concatenate([rows.moments.steps, fresh.moments.steps]),
        ),
        lineage,
    )
