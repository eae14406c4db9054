"""The law of the slots: what a page holds after any changes is the cut of the server, node by node."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from splatree.kernels.cpu.codec.nodes import pack_nodes
from splatree.view import slots as module
from splatree.view.slots import Slots

from .scenes import scene

CENTRE = np.zeros(3)
FAR = np.array([0.0, 0.0, -9.0])


class Mirror:
    """What a page does with the changes."""

    def __init__(self, capacity):
        self.words = np.zeros((capacity, 8), np.uint32)
        self.live = np.zeros(capacity, bool)

    def take(self, change):
        assert self.live[change.drop].all()
        self.live[change.drop] = False
        assert not self.live[change.add].any()
        self.live[change.add] = True
        self.words[change.add] = change.nodes
        assert self.live[change.tint].all()
        self.words[change.tint, 4] = change.colors


@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(0, 400), min_size=1, max_size=6),
)
def test_a_page_holds_the_cut_after_any_changes(seed, counts):
    rng = np.random.default_rng(seed)
    shown = scene()
    slots, mirror = Slots(shown, CENTRE, 512), Mirror(512)
    for count in counts:
        rows = np.sort(rng.choice(len(shown), count, replace=False)).astype(np.int32)
        mirror.take(slots.move(rows, FAR))
        assert mirror.live.sum() == count
        assert set(np.flatnonzero(mirror.live)) == set(slots.slots.tolist())
        np.testing.assert_array_equal(
            mirror.words[slots.slots], pack_nodes(shown.gaussians, shown.tree, rows, FAR, CENTRE)
        )


def test_the_same_cut_again_sends_nothing():
    slots = Slots(scene(), CENTRE, 512)
    rows = np.arange(300, dtype=np.int32)
    slots.move(rows, FAR)
    again = slots.move(rows, FAR)
    assert (len(again.drop), len(again.add), len(again.tint), again.payload) == (0, 0, 0, b"")


def test_the_slots_can_be_filled_to_the_last():
    slots, mirror = Slots(scene(), CENTRE, 400), Mirror(400)
    for first in (0, 400, 800, 200):
        mirror.take(slots.move(np.arange(first, first + 400, dtype=np.int32), FAR))
        assert mirror.live.all()


def test_colours_follow_an_eye_that_moves_and_not_one_that_rests():
    shown = scene()
    slots, mirror = Slots(shown, CENTRE, 512), Mirror(512)
    rows = np.arange(300, dtype=np.int32)
    mirror.take(slots.move(rows, FAR))
    near = slots.move(rows, FAR + [0.02, 0, 0])
    assert len(near.tint) == 0
    there = np.array([9.0, 0.0, 0.0])
    change = slots.move(rows, there)
    assert len(change.tint) == 300
    assert not change.is_behind
    mirror.take(change)
    np.testing.assert_array_equal(
        mirror.words[slots.slots], pack_nodes(shown.gaussians, shown.tree, rows, there, CENTRE)
    )


def test_a_scene_without_harmonics_sends_no_colours():
    slots = Slots(scene(degree=0), CENTRE, 512)
    rows = np.arange(300, dtype=np.int32)
    slots.move(rows, FAR)
    assert len(slots.move(rows, -FAR).tint) == 0


def test_colours_of_many_nodes_come_in_parts(monkeypatch):
    monkeypatch.setattr(module, "TINTS", 100)
    slots = Slots(scene(), CENTRE, 512)
    rows = np.arange(250, dtype=np.int32)
    slots.move(rows, FAR)
    sent, steps = 0, 0
    while True:
        change = slots.move(rows, -FAR)
        sent, steps = sent + len(change.tint), steps + 1
        if not change.is_behind:
            break
    assert (sent, steps) == (250, 3)
