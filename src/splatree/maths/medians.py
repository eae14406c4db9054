"""Medians of values that come in chunks, as often as they are asked for: exact, and with little memory.

The bits of a float, read as a number, are in the order of the floats. So the middle values are looked for between a lowest and a
highest number: that range is divided into 65,536 bins, values are counted, and the bin of the middle ones is the next range.

Cost: three passes over the values as a rule, and 8 bytes for each of a million values.
"""

from collections.abc import Callable, Iterable

import numpy as np

from splatree.shapes import Array, UInt64

__all__ = ["median_of"]

NUM_BINS = 1 << 16
"""Bins of a pass."""

ROOM = 1 << 20
"""Values that are sorted in memory."""

_SIGN = np.uint64(1 << 63)


def median_of(chunks: Callable[[], Iterable[Array]], num_values: int) -> float:
    """The median, as numpy.median finds it of all values as float64.

    Args:
        chunks: begins a pass over the values, which are not NaN.
        num_values: how many there are, at least one.
    """
    below, wanted = (num_values - 1) // 2, num_values // 2  # both middle values; of an odd number they are one
    low, high = 0, 2**64 - 1
    num_lower, num_inside = 0, num_values
    while num_inside > ROOM and low < high:
        width = (high - low) // NUM_BINS + 1
        counts = np.zeros(NUM_BINS, np.int64)
        for keys in _inside(chunks, low, high):
            counts += np.bincount(((keys - np.uint64(low)) // np.uint64(width)).astype(np.intp), minlength=NUM_BINS)
        ends = num_lower + np.cumsum(counts)
        first, last = (int(np.searchsorted(ends, rank, side="right")) for rank in (below, wanted))
        if first < last:  # nothing lies between them
            lower = max(int(keys.max()) for keys in _inside(chunks, low, low + (first + 1) * width - 1) if len(keys))
            upper = min(int(keys.min()) for keys in _inside(chunks, low + last * width, high) if len(keys))
            return _mean(lower, upper)
        num_lower, num_inside = int(ends[first] - counts[first]), int(counts[first])
        low, high = low + first * width, min(high, low + (first + 1) * width - 1)
    if low == high:
        return _mean(low, low)
    left = np.sort(np.concatenate([np.zeros(0, np.uint64), *_inside(chunks, low, high)]))
    return _mean(int(left[below - num_lower]), int(left[wanted - num_lower]))


def _inside(chunks: Callable[[], Iterable[Array]], low: int, high: int) -> Iterable[UInt64[Array, "m"]]:
    """The keys of a pass that are from ``low`` to ``high``."""
    for values in chunks():
        bits = np.ascontiguousarray(values, np.float64).view(np.uint64)
        keys = np.where(bits & _SIGN, ~bits, bits | _SIGN)
        yield keys[(keys >= np.uint64(low)) & (keys <= np.uint64(high))]


def _mean(lower: int, upper: int) -> float:
    keys = np.array([lower, upper], np.uint64)
    values = np.where(keys & _SIGN, keys & ~_SIGN, ~keys).view(np.float64)
    return float(values.mean())
