"""A codebook of 256 values for numbers, with the least squared error.

The optimum of Lloyd (1982, "Least squares quantization in PCM"): each value is the mean of the numbers that are nearest to it.
In one dimension it is found exactly by dynamic programming. Where there are more than some thousand numbers they are first
counted in cells, whose density goes as that of the best values: with the cube root of the numbers' density (Panter & Dite 1951).
The optimum over cells is then made one over numbers by a few of Lloyd's rounds, which move each bound by less than a cell.

Cost: sorting a sample, and about 20 ms for the intervals, however many numbers there are.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu.codec.intervals import best_intervals
from splatree.shapes import Array, Float32, check_fields

__all__ = ["CODES", "Codebook", "find_codebook", "sampled_rows"]

CODES = 256
"""Values of a codebook."""

_SAMPLE = 1 << 18
"""Numbers looked at, about a thousand a value: the error is 0.1 % above that of all."""

_CELLS = 1 << 11
"""Eight cells a value."""

_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Codebook:
    """256 values, ascending."""

    values: Float32[Array, "256"]
    """What each code stands for; codes that no number has repeat the last value."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def bounds(self) -> Float32[Array, "255"]:
        """Halfway between neighbours: the code of a number is how many bounds lie below it."""
        low, high = self.values[:-1], self.values[1:]
        middle = ((low.astype(np.float64) + high) / 2).astype(np.float32)
        return np.where(middle < high, middle, low)  # of neighbouring floats the middle may be rounded to the upper one


def sampled_rows(num_rows: int, width: int) -> slice:
    """Rows that are enough to find the codebook of ``num_rows`` rows of ``width`` numbers."""
    return slice(0, None, max(1, -(-num_rows * width // _SAMPLE)))


def find_codebook(sample: Array, all_values: Callable[[], Array], weights: Array | None = None) -> Codebook:
    """The codebook of numbers of which ``sample`` "n c" are rows, weighted.

    ``all_values`` gives the different ones among all numbers; it is asked for them if a sample has few. If there are at most 256,
    the codebook has them exactly.
    """
    values = np.unique(sample)
    if len(values) <= CODES:  # perhaps in all, as in a scene that was read from a codebook
        values = np.unique(all_values())
    if len(values) > CODES:
        x = sample.ravel().astype(np.float64)
        w = np.ones(len(x)) if weights is None else np.repeat(weights.astype(np.float64), sample.shape[1])
        order = np.argsort(x, kind="stable")
        values = _best_values(x[order], w[order])
    padded = np.zeros(CODES, np.float32)
    padded[: len(values)] = values
    padded[len(values) :] = values[-1] if len(values) else 0
    return Codebook(padded)


def _best_values(x: Array, w: Array) -> Array:
    """Means of the best division of ascending ``x`` with weights ``w`` into at most 256 intervals."""
    mass, moment = (np.concatenate([[0.0], np.cumsum(values)]) for values in (w, w * x))
    # The first number of each cell: for few numbers each different one, for many some of equal shares of density^⅓.
    first = np.flatnonzero(np.diff(x, prepend=-np.inf))
    if len(first) > _CELLS:
        edges = np.interp(np.linspace(0, mass[-1], 2 * _CELLS + 1), mass[1:], x)
        shares = np.concatenate(
            [[0.0], np.cumsum(np.diff(edges) ** (2 / 3))]
        )  # (m / s)^⅓ s of a cell of mass m and size s
        edges = np.interp(np.linspace(0, shares[-1], _CELLS + 1)[:-1], shares, edges)
        first = np.unique(np.concatenate([[0], np.searchsorted(x, edges[1:])]))
    ends = np.append(first, len(x))
    masses = np.diff(mass[ends])
    means = np.diff(moment[ends]) / np.where(masses > 0, masses, 1.0)
    cuts = ends[best_intervals(means, masses, min(CODES, len(means)))]
    values = _means(mass, moment, cuts)
    for _ in range(_ROUNDS):
        bounds = np.searchsorted(x, (values[1:] + values[:-1]) / 2)
        values = _means(mass, moment, np.unique(np.concatenate([[0], bounds, [len(x)]])))
    return values


def _means(mass: Array, moment: Array, cuts: Array) -> Array:
    return np.asarray(np.diff(moment[cuts]) / np.diff(mass[cuts]))
