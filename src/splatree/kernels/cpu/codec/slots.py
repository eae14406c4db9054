"""Slots of a page's nodes, natively; kernels/reference/slots.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["drifted", "keep", "release", "stale"]


def keep(
    rows: Int32[Array, "v"], slot_after: Int32[Array, "n"], stamps: Int32[Array, "s"], step: int
) -> tuple[Int32[Array, "v"], Int32[Array, "a"]]:
    """The slots of ``rows``, which are marked with the step, −1 for none, and the places of the rows that have none."""
    slots, places = np.empty(len(rows), np.int32), np.empty(len(rows), np.int32)
    return slots, places[: _core.keep_slots(rows, slot_after, stamps, step, slots, places)]


def release(
    held: Int32[Array, "u"],
    slots: Int32[Array, "u"],
    slot_after: Int32[Array, "n"],
    stamps: Int32[Array, "s"],
    step: int,
) -> Int32[Array, "d"]:
    """Take the ``slots`` of the ``held`` rows that are not marked with the step; the slots, in the order of the rows."""
    out = np.empty(len(held), np.int32)
    return out[: _core.release_slots(held, slots, slot_after, stamps, step, out)]


def stale(
    slots: Int32[Array, "v"],
    means: Float32[Array, "s 3"],
    eyes: Float32[Array, "s 3"],
    view: tuple[Float64[Array, "3"], Float64[Array, "3"], float],
    first: int,
    limit: int,
) -> tuple[Int32[Array, "t"], bool]:
    """The first ``limit`` places of slots, from ``first`` on, whose colours the eye has left behind; whether there are more."""
    out = np.empty(min(len(slots), limit) + 1, np.int32)
    count = _core.stale_slots(slots, means, eyes, *view, first, limit, out)
    return out[: min(count, limit)], count > limit


def drifted(
    slots: Int32[Array, "v"],
    means: Float32[Array, "s 3"],
    limits: Float32[Array, "s"],
    sent: Float32[Array, "s"],
    depths: tuple[Float64[Array, "4"], float],
    factor: float,
) -> tuple[Int32[Array, "d"], Float32[Array, "d"]]:
    """The places of slots whose nodes were sent with another dilation than they have by now, by more than a factor, and the
    dilations that they have."""
    out, now = np.empty(len(slots), np.int32), np.empty(len(slots), np.float32)
    count = _core.drifted_slots(slots, means, limits, sent, *depths, factor, out, now)
    return out[:count], now[:count]
