"""Histograms for the terminal, one line a bin."""

from dataclasses import dataclass

import numpy as np

from splatree.shapes import Array

BINS = 8
WIDTH = 30
"""Characters of the longest bar."""
SHARES = (0.001, 0.999)
"""Quantiles between which the bins of a logarithmic histogram lie: outliers count in the first and the last bin."""


@dataclass(frozen=True)
class Histogram:
    """How many values lie in each bin."""

    edges: tuple[float, ...]
    """Bounds of the bins, ascending: one more than bins."""
    counts: tuple[int, ...]
    """Values in each bin; the first and the last also hold what lies beyond them."""


def linear(values: Array, low: float, high: float) -> Histogram:
    """Bins of equal width."""
    return _counted(values, np.linspace(low, high, BINS + 1))


def logarithmic(values: Array) -> Histogram:
    """Bins of equal ratio; one bin where all values are the same, none where there are no positive ones."""
    positive = values[values > 0]
    if len(positive) == 0:
        return Histogram((), ())
    low, high = np.quantile(positive, SHARES)
    edges = np.geomspace(low, high, BINS + 1) if high > low * (1 + 1e-6) else np.array([low, high])
    return _counted(values, edges)


def _counted(values: Array, edges: Array) -> Histogram:
    bins = np.searchsorted(edges[1:-1], values, side="right")
    counts = np.bincount(bins, minlength=len(edges) - 1)
    return Histogram(tuple(map(float, edges)), tuple(map(int, counts)))


def in_lines(title: str, histogram: Histogram) -> list[str]:
    """The title, and a line for each bin: its bounds, a bar, its share."""
    total = sum(histogram.counts)
    if total == 0:
        return []
    most = max(histogram.counts)
    bounds = [f"{low:.3g} to {high:.3g}" for low, high in zip(histogram.edges, histogram.edges[1:], strict=False)]
    room = max(map(len, bounds))
    bars = ["█" * max(round(WIDTH * count / most), 1 if count else 0) for count in histogram.counts]
    lines = zip(bounds, bars, histogram.counts, strict=True)
    return [title, *(f"  {b.rjust(room)}  {bar.ljust(WIDTH)}  {100 * n / total:4.1f} %" for b, bar, n in lines)]
