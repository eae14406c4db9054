"""Slots of a page's nodes, natively; kernels/reference/slots.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["keep", "release", "stale"]


def keep(
    rows: Int32[Array, "v"], slot_after: Int32[Array, "n"], stamps: Int32[Array, "s"], step: int
) -> Int32[Array, "a"]:
    """Mark the slots of ``rows`` with the step; the rows that have none."""
    out = np.empty(len(rows), np.int32)
    return out[: _core.keep_slots(rows, slot_after, stamps, step, out)]


def release(
    held: Int32[Array, "u"], slot_after: Int32[Array, "n"], stamps: Int32[Array, "s"], step: int
) -> Int32[Array, "d"]:
    """Take the slots of the ``held`` rows that are not marked with the step; the slots, in the order of the rows."""
    out = np.empty(len(held), np.int32)
    return out[: _core.release_slots(held, slot_after, stamps, step, out)]


def stale(
    rows: Int32[Array, "v"],
    slot_after: Int32[Array, "n"],
    means: Float32[Array, "n 3"],
    eyes: Float32[Array, "s 3"],
    view: tuple[Float64[Array, "3"], Float64[Array, "3"], float],
    limit: int,
) -> tuple[Int32[Array, "t"], bool]:
    """The first ``limit`` rows whose colours the eye has left behind, and whether there are more."""
    out = np.empty(min(len(rows), limit) + 1, np.int32)
    count = _core.stale_slots(rows, slot_after, means, eyes, *view, limit, out)
    return out[: min(count, limit)], count > limit
