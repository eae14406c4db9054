"""The numbered slots in which a page of the viewer keeps its nodes: the definition of four passes over the rows of a cut."""

import numpy as np

from splatree.shapes import Array, Float32, Float64, Int32

__all__ = ["drifted", "keep", "release", "stale"]


def keep(
    rows: Int32[Array, "v"], slot_after: Int32[Array, "n"], stamps: Int32[Array, "s"], step: int
) -> tuple[Int32[Array, "v"], Int32[Array, "a"]]:
    """The slots of ``rows``, which are marked with the step, and the places of the rows that have none.

    These have −1; ``slot_after`` is the slot + 1 of each row, 0 for none.
    """
    slots = slot_after[rows] - 1
    stamps[slots[slots >= 0]] = step
    return np.asarray(slots), np.flatnonzero(slots < 0).astype(np.int32)


def release(
    held: Int32[Array, "u"],
    slots: Int32[Array, "u"],
    slot_after: Int32[Array, "n"],
    stamps: Int32[Array, "s"],
    step: int,
) -> Int32[Array, "d"]:
    """Take the ``slots`` of the ``held`` rows that are not marked with the step; the slots, in the order of the rows."""
    gone = stamps[slots] != step
    slot_after[held[gone]] = 0
    return np.asarray(slots[gone])


def stale(
    slots: Int32[Array, "v"],
    means: Float32[Array, "s 3"],
    eyes: Float32[Array, "s 3"],
    view: tuple[Float64[Array, "3"], Float64[Array, "3"], float],
    first: int,
    limit: int,
) -> tuple[Int32[Array, "t"], bool]:
    """The first ``limit`` places of slots whose colours the eye has left behind, and whether there are more.

    They are looked through from the place ``first`` on, and from the beginning after the end. ``means`` are those of the slots'
    nodes, ``eyes`` is where each slot's colour was seen from, relative to a centre. ``view`` is the eye, the centre, and the
    share of the distance by which the eye may move.
    """
    eye, centre, share = view
    here = (eye - centre).astype(np.float32)
    moved = ((eyes[slots] - here) ** 2).sum(axis=1)
    distance = ((means[slots] - eye.astype(np.float32)) ** 2).sum(axis=1)
    is_stale = moved > np.float32(share**2) * distance
    found = (first + np.flatnonzero(np.roll(is_stale, -first))) % max(len(slots), 1)
    return found[:limit].astype(np.int32), len(found) > limit


def drifted(
    slots: Int32[Array, "v"],
    means: Float32[Array, "s 3"],
    limits: Float32[Array, "s"],
    sent: Float32[Array, "s"],
    depths: tuple[Float64[Array, "4"], float],
    factor: float,
) -> tuple[Int32[Array, "d"], Float32[Array, "d"]]:
    """The places of slots whose nodes were sent with another dilation than they have by now, by more than a factor, and the
    dilations that they have.

    The dilation, world units², is that of a pixel at the depth of the mean, at most the limit of the node. ``depths`` are the
    plane (n, d) with the depth n·p + d, and the dilation at depth 1.
    """
    plane, unit = depths
    depth = means[slots].astype(np.float64) @ plane[:3] + plane[3]
    now, before = np.minimum(unit * depth * depth, limits[slots]), sent[slots].astype(np.float64)
    places = np.flatnonzero((now > factor * before) | (factor * now < before)).astype(np.int32)
    return places, now[places].astype(np.float32)
