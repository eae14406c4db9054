"""What a page holds, slot by slot, and what takes it from one cut to the next.

A page keeps its nodes in numbered slots. The numbers are given out here, so a message needs no answer: each one names the slots
that fall free and the slots that new nodes go into, and turns one exact cut into another. Cost of a step: a few passes over the
rows of the cut; memory: 4 bytes a row of the scene, touched where rows were shown, and 16 bytes a slot.
"""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu.codec.nodes import pack_colors, pack_nodes
from splatree.kernels.cpu.codec.slots import keep, release, stale
from splatree.scene.scene import Scene
from splatree.scene.view import View
from splatree.shapes import Array, Float64, Int32, UInt32
from splatree.view.follow import dilations_of, followed, has_drifted

__all__ = ["Change", "Slots"]

EYE_SHARE = 0.05
"""A node's colour is sent again when the eye has moved by this share of its distance since: an angle of 3° at most."""

TINTS = 20_000
"""Colours sent again in one message at most; the rest follows: 160 kB, a third of what the page takes in anyway."""


@dataclass(frozen=True, eq=False)
class Change:
    """What takes a page from one cut to the next."""

    drop: UInt32[Array, "d"]
    """Slots that fall free."""
    add: UInt32[Array, "a"]
    """Slots that are filled; some may have fallen free by the same change."""
    nodes: UInt32[Array, "a 8"]
    """What they are filled with (kernels/reference/nodes.py)."""
    tint: UInt32[Array, "t"]
    """Slots whose colour changes."""
    colors: UInt32[Array, "t"]
    """Their colours."""
    is_behind: bool
    """Whether more colours have to change than one message holds."""

    @property
    def payload(self) -> bytes:
        """All arrays one after the other, little-endian."""
        parts = (self.drop, self.add, self.nodes, self.tint, self.colors)
        return b"".join(np.ascontiguousarray(part, "<u4").tobytes() for part in parts)


class Slots:
    """The slots of one page; not for several threads at once."""

    def __init__(self, scene: Scene, centre: Float64[Array, "3"], capacity: int) -> None:
        self._scene, self._centre, self.capacity = scene, centre, capacity
        self._slot_after = np.zeros(
            len(scene), np.int32
        )  # slot + 1 of each row, 0 for none: zeros cost no memory at first
        self._stamps = np.zeros(capacity, np.int32)  # the last step in which each slot was used
        self._step = 0
        self._free = np.arange(capacity - 1, -1, -1, dtype=np.int32)  # a stack of free slots …
        self._num_free = capacity  # … up to here
        self._eyes = np.zeros((capacity, 3), np.float32) if scene.gaussians.sh_degree else None
        self._eye: Float64[Array, 3] | None = None
        self._is_behind = False
        self._dilations = np.zeros(capacity, np.float32)  # that each node was sent with
        self.rows: Int32[Array, v] = np.zeros(0, np.int32)
        """Rows that the page holds, ascending."""

    @property
    def slots(self) -> Int32[Array, "v"]:
        """The slot of each row that the page holds."""
        return self._slot_after[self.rows] - 1

    def move(self, rows: Int32[Array, "v"], eye: Float64[Array, "3"], view: View | None = None) -> Change:
        """Let the page hold ``rows``, ascending, at most as many as there are slots, seen from ``eye``.

        With the ``view`` that is drawn, merged nodes are sent as they look at their pixel; without, as they are stored.
        """
        self._step += 1
        drifted = self._let_drift(view)
        new = keep(rows, self._slot_after, self._stamps, self._step)
        drop = np.concatenate([drifted, release(self.rows, self._slot_after, self._stamps, self._step)])
        self._free[self._num_free : self._num_free + len(drop)] = drop
        top = self._num_free + len(drop)
        self._num_free = top - len(new)
        add = self._free[self._num_free : top].copy()
        self._slot_after[new] = add + 1
        if self._eyes is not None:
            self._eyes[add] = eye - self._centre
        self.rows = rows
        nodes = pack_nodes(self._scene.gaussians, self._scene.tree, new, eye, self._centre)
        dilations = dilations_of(self._scene, new, view)
        if dilations is not None:
            nodes = followed(nodes, self._scene, new, dilations)
            self._dilations[add] = dilations
        tint, colors = self._tints(eye)
        return Change(drop.view(np.uint32), add.view(np.uint32), nodes, tint.view(np.uint32), colors, self._is_behind)

    def _let_drift(self, view: View | None) -> Int32[Array, "d"]:
        """Slots of nodes that look too different by now; their rows are forgotten, so that they come again as new ones."""
        now = dilations_of(self._scene, self.rows, view)
        if now is None:
            return np.zeros(0, np.int32)
        slots = self.slots
        drifts = has_drifted(now, self._dilations[slots])
        self._slot_after[self.rows[drifts]] = 0
        self.rows = self.rows[~drifts]
        return slots[drifts]

    def _tints(self, eye: Array) -> tuple[Int32[Array, "t"], UInt32[Array, "t"]]:
        """The slots whose colours the eye has left behind, and their new colours."""
        if self._eyes is None or (not self._is_behind and self._eye is not None and np.array_equal(eye, self._eye)):
            return np.zeros(0, np.int32), np.zeros(0, np.uint32)
        self._eye = eye
        g, view = self._scene.gaussians, (eye, self._centre, EYE_SHARE)
        rows, self._is_behind = stale(self.rows, self._slot_after, g.means, self._eyes, view, TINTS)
        slots = self._slot_after[rows] - 1
        self._eyes[slots] = eye - self._centre
        return slots, pack_colors(g, rows, eye)
