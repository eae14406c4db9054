"""What a page holds, slot by slot, and what takes it from one cut to the next.

A page keeps its nodes in numbered slots. The numbers are given out here, so a message needs no answer: each one names the slots
that fall free and the slots that new nodes go into, and turns one exact cut into another. Cost of a step: a few passes over the
rows of the cut; memory: 4 bytes a row of the scene, touched where rows were shown, and 40 bytes a slot.
"""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu.codec.nodes import pack_colors, pack_nodes, pack_shapes
from splatree.kernels.cpu.codec.slots import drifted, keep, release, stale
from splatree.kernels.reference.nodes import NODE_WORDS, with_depths
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float64, Int32, UInt32
from splatree.view.follow import DRIFT, Depths, depths_of, dilations_at
from splatree.view.shown import Shown

__all__ = ["Change", "Slots", "in_runs"]

EYE_SHARE = 0.05
"""A node's colour is sent again when the eye has moved by this share of its distance since: an angle of 3° at most."""

TINTS = 25_000
"""Colours sent again in one message at most; the rest follows: 200 kB, a third of what the page takes in anyway. At steps of 2°
about a city the colours of a page have a root mean square error of 0.02, of 0 to 1."""


@dataclass(frozen=True, eq=False)
class Change:
    """What takes a page from one cut to the next."""

    drop: UInt32[Array, "d"]
    """Slots that fall free, one by one."""
    runs: UInt32[Array, "r 2"]
    """Slots that fall free and follow each other: the first, and how many. A page that is sent elsewhere drops nearly all of its
    slots, which would take a megabyte one by one."""
    add: UInt32[Array, "a"]
    """Slots that are filled; some may have fallen free by the same change."""
    nodes: UInt32[Array, "a 8"]
    """What they are filled with (kernels/reference/nodes.py)."""
    shaped: UInt32[Array, "s"]
    """Slots whose node looks otherwise at its pixel by now."""
    shapes: UInt32[Array, "s 2"]
    """Their opacities and scales."""
    tint: UInt32[Array, "t"]
    """Slots whose colour changes."""
    colors: UInt32[Array, "t"]
    """Their colours."""
    is_behind: bool
    """Whether more colours and shapes have to change than this message holds."""

    @property
    def payload(self) -> bytes:
        """All arrays one after the other, little-endian."""
        parts = (self.drop, self.runs, self.add, self.nodes, self.shaped, self.shapes, self.tint, self.colors)
        return b"".join(np.ascontiguousarray(part, "<u4").tobytes() for part in parts)


def in_runs(slots: Int32[Array, "d"]) -> tuple[UInt32[Array, "s"], UInt32[Array, "r 2"]]:
    """Slots one by one, and those of three and more that follow each other as runs: the first, and how many."""
    ascending = np.sort(slots).astype(np.uint32)
    starts = np.flatnonzero(np.diff(ascending.astype(np.int64), prepend=-2) != 1)
    counts = np.diff(starts, append=len(ascending))
    is_long = counts > 2
    runs = np.stack([ascending[starts[is_long]], counts[is_long].astype(np.uint32)], axis=1)
    return ascending[~np.repeat(is_long, counts)], runs


class Slots:
    """The slots of one page; not for several threads at once."""

    def __init__(self, shown: Shown, centre: Float64[Array, "3"], capacity: int) -> None:
        self._shown, self._centre, self.capacity = shown, centre, capacity
        # Slot + 1 of each row, 0 for none: zeros cost no memory at first.
        self._slot_after = np.zeros(shown.num_nodes, np.int32)
        self._stamps = np.zeros(capacity, np.int32)  # the last step in which each slot was used
        self._step = 0
        self._free = np.arange(capacity - 1, -1, -1, dtype=np.int32)  # a stack of free slots …
        self._num_free = capacity  # … up to here
        self._means = np.zeros((capacity, 3), np.float32)
        self._eyes = np.zeros((capacity, 3), np.float32) if shown.scene.gaussians.sh_degree else None
        self._eye: Float64[Array, 3] | None = None
        self._is_behind = False
        self._first_behind = 0  # the row from which on colours are looked through: those behind the last message's
        self._dilations = np.zeros(capacity, np.float32)  # that each node was sent with
        self._limits = np.zeros(capacity, np.float32)  # the largest dilation that changes a node
        self.rows: Int32[Array, v] = np.zeros(0, np.int32)
        """Rows that the page holds, ascending."""
        self.slots: Int32[Array, v] = np.zeros(0, np.int32)
        """The slot of each of them."""

    def move(
        self,
        rows: Int32[Array, "v"],
        eye: Float64[Array, "3"],
        view: View | None = None,
        *,
        has_colors: bool = True,
        has_shapes: bool = True,
    ) -> Change:
        """Let the page hold ``rows``, ascending, at most as many as there are slots, seen from ``eye``.

        Without ``has_colors``, colours that the eye has left behind wait for a later change. Without ``has_shapes``, so do shapes
        of nodes whose pixel has changed.

        With the ``view`` that is drawn, merged nodes are sent as they look at their pixel; without, as they are stored.
        """
        self._step += 1
        depths = depths_of(view) if self._shown.follows else None
        slots, places = keep(rows, self._slot_after, self._stamps, self._step)
        drop = release(self.rows, self.slots, self._slot_after, self._stamps, self._step)
        self._free[self._num_free : self._num_free + len(drop)] = drop
        top = self._num_free + len(drop)
        self._num_free = top - len(places)
        add, new = self._free[self._num_free : top].copy(), rows[places]
        self._slot_after[new] = add + 1
        slots[places] = add
        if self._eyes is not None:
            self._eyes[add] = eye - self._centre
        self.rows, self.slots = rows, slots
        nodes = self._nodes(new, add, eye, depths)
        shaped, shapes, is_behind = self._shapes(depths, is_sent=has_shapes)
        tint, colors = self._tints(eye, limit=TINTS if has_colors else 0)
        added, changed, tinted = (places.view(np.uint32) for places in (add, shaped, tint))
        return Change(*in_runs(drop), added, nodes, changed, shapes, tinted, colors, self._is_behind or is_behind)

    def holds(self, rows: Int32[Array, "v"]) -> Bool[Array, "v"]:
        """Which of these rows the page holds."""
        return np.asarray(self._slot_after[rows] != 0)

    def num_new(self, rows: Int32[Array, "v"]) -> int:
        """How many of these rows the page does not hold."""
        return int(np.count_nonzero(self._slot_after[rows] == 0))

    def _nodes(
        self, rows: Int32[Array, "a"], slots: Int32[Array, "a"], eye: Array, depths: Depths | None
    ) -> UInt32[Array, "a 8"]:
        """Rows as they go into slots."""
        nodes = np.empty((len(rows), NODE_WORDS), np.uint32)
        for part in self._shown.parts(rows):
            own, curves = slots[part.of_rows], part.tree.curves
            self._means[own] = part.gaussians.means[part.places]
            dilations = None
            if curves is not None and depths is not None:
                limits = curves[part.places, 3]
                dilations = dilations_at(self._means[own], limits, depths)
                self._limits[own], self._dilations[own] = limits, dilations
            nodes[part.of_rows] = pack_nodes(part.gaussians, part.tree, part.places, eye, self._centre, dilations)
        with_depths(nodes, self._shown.depths(rows))
        return nodes

    def _shapes(self, depths: Depths | None, *, is_sent: bool) -> tuple[Int32[Array, "s"], UInt32[Array, "s 2"], bool]:
        """The slots of merged nodes that look too different by now, and how they look; whether some are not sent."""
        nothing = np.zeros(0, np.int32), np.zeros((0, 2), np.uint32)
        if depths is None:
            return *nothing, False
        places, dilations = drifted(self.slots, self._means, self._limits, self._dilations, depths, DRIFT)
        if not is_sent:
            return *nothing, len(places) > 0
        rows, slots = self.rows[places], self.slots[places]
        self._dilations[slots] = dilations
        shapes = np.empty((len(rows), 2), np.uint32)
        for part in self._shown.parts(rows):
            shapes[part.of_rows] = pack_shapes(part.gaussians, part.tree, part.places, dilations[part.of_rows])
        return slots, shapes, False

    def _tints(self, eye: Array, *, limit: int) -> tuple[Int32[Array, "t"], UInt32[Array, "t"]]:
        """The slots whose colours the eye has left behind, and their new colours."""
        if self._eyes is None or (not self._is_behind and self._eye is not None and np.array_equal(eye, self._eye)):
            return np.zeros(0, np.int32), np.zeros(0, np.uint32)
        self._eye = eye
        view, first = (eye, self._centre, EYE_SHARE), int(np.searchsorted(self.rows, self._first_behind))
        places, self._is_behind = stale(
            self.slots, self._means, self._eyes, view, first % max(len(self.rows), 1), limit
        )
        rows, slots = self.rows[places], self.slots[places]
        if len(rows):
            self._first_behind = int(rows[-1]) + 1
        self._eyes[slots] = eye - self._centre
        colors = np.empty(len(rows), np.uint32)
        for part in self._shown.parts(rows):
            colors[part.of_rows] = pack_colors(part.gaussians, part.places, eye)
        return slots, colors
