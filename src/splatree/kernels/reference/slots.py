"""The numbered slots in which a page of the viewer keeps its nodes: the definition of three passes over the rows of a cut."""

import numpy as np

from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["keep", "release", "stale"]


def keep(
    rows: Int32[Array, "v"], slot_after: Int32[Array, "n"], stamps: Int32[Array, "s"], step: int
) -> Int32[Array, "a"]:
    """Mark the slots of ``rows`` with the step; the rows that have none (``slot_after``, the slot + 1, is 0)."""
    slots = slot_after[rows] - 1
    stamps[slots[slots >= 0]] = step
    return np.asarray(rows[slots < 0])


def release(
    held: Int32[Array, "u"], slot_after: Int32[Array, "n"], stamps: Int32[Array, "s"], step: int
) -> Int32[Array, "d"]:
    """Take the slots of the ``held`` rows that are not marked with the step; the slots, in the order of the rows."""
    slots = slot_after[held] - 1
    gone = stamps[slots] != step
    slot_after[held[gone]] = 0
    return np.asarray(slots[gone])


def stale(
    rows: Int32[Array, "v"],
    slot_after: Int32[Array, "n"],
    means: Float32[Array, "n 3"],
    eyes: Float32[Array, "s 3"],
    view: tuple[Float64[Array, "3"], Float64[Array, "3"], float],
    limit: int,
) -> tuple[Int32[Array, "t"], bool]:
    """The first ``limit`` rows whose colours the eye has left behind, and whether there are more.

    ``eyes`` is where each slot's colour was seen from, relative to a centre. ``view`` is the eye, the centre, and the share of
    the distance by which the eye may move.
    """
    eye, centre, share = view
    here = (eye - centre).astype(np.float32)
    moved = ((eyes[slot_after[rows] - 1] - here) ** 2).sum(axis=1)
    distance = ((means[rows] - eye.astype(np.float32)) ** 2).sum(axis=1)
    found = rows[moved > np.float32(share**2) * distance]
    return found[:limit], len(found) > limit
