"""The law of the slots: what a page holds after any changes is the cut of the server, node by node."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import splatree
from splatree.kernels.cpu.codec.nodes import pack_nodes
from splatree.kernels.reference.project import follow
from splatree.view import slots as module
from splatree.view.shown import InMemory
from splatree.view.slots import Slots, in_runs

from .scenes import scene

CENTRE = np.zeros(3)
FAR = np.array([0.0, 0.0, -9.0])


class Mirror:
    """What a page does with the changes."""

    def __init__(self, capacity):
        self.words = np.zeros((capacity, 8), np.uint32)
        self.live = np.zeros(capacity, bool)

    def take(self, change):
        for dropped in (change.drop, *(np.arange(first, first + count) for first, count in change.runs)):
            assert self.live[dropped].all()
            self.live[dropped] = False
        assert not self.live[change.add].any()
        self.live[change.add] = True
        self.words[change.add] = change.nodes
        assert self.live[change.shaped].all()
        halves = self.words.view(np.uint16)
        halves[np.ix_(change.shaped, [7, 13, 14, 15])] = change.shapes.view(np.uint16).reshape(-1, 4)
        assert self.live[change.tint].all()
        self.words[change.tint, 4] = change.colors


@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(0, 400), min_size=1, max_size=6),
)
def test_a_page_holds_the_cut_after_any_changes(seed, counts):
    rng = np.random.default_rng(seed)
    shown = scene()
    slots, mirror = Slots(InMemory(shown), CENTRE, 512), Mirror(512)
    for count in counts:
        rows = np.sort(rng.choice(len(shown), count, replace=False)).astype(np.int32)
        mirror.take(slots.move(rows, FAR))
        assert mirror.live.sum() == count
        assert set(np.flatnonzero(mirror.live)) == set(slots.slots.tolist())
        np.testing.assert_array_equal(
            mirror.words[slots.slots], pack_nodes(shown.gaussians, shown.tree, rows, FAR, CENTRE)
        )


def test_the_same_cut_again_sends_nothing():
    slots = Slots(InMemory(scene()), CENTRE, 512)
    rows = np.arange(300, dtype=np.int32)
    slots.move(rows, FAR)
    again = slots.move(rows, FAR)
    assert (len(again.drop), len(again.runs), len(again.add), len(again.tint), again.payload) == (0, 0, 0, 0, b"")


def test_a_page_that_is_sent_elsewhere_is_told_of_runs():
    slots = Slots(InMemory(scene()), CENTRE, 2048)
    slots.move(np.arange(900, dtype=np.int32), FAR)
    change = slots.move(np.arange(900, 950, dtype=np.int32), FAR)
    assert len(change.drop) == 0 and change.runs.tolist() == [[0, 900]]


@given(st.lists(st.integers(0, 60), unique=True))
def test_runs_are_long_and_name_every_slot_once(numbers):
    singles, runs = in_runs(np.array(numbers, np.int32))
    named = [*singles.tolist(), *(slot for first, count in runs.tolist() for slot in range(first, first + count))]
    assert sorted(named) == sorted(numbers) and all(count > 2 for _, count in runs.tolist())
    assert not any({slot, slot + 1, slot + 2} <= set(singles.tolist()) for slot in numbers)


def test_colours_wait_for_a_change_that_has_them():
    slots = Slots(InMemory(scene()), CENTRE, 2048)
    rows = np.arange(900, dtype=np.int32)
    slots.move(rows, FAR)
    near = FAR / 3
    waiting = slots.move(rows, near, has_colors=False)
    assert len(waiting.tint) == 0 and waiting.is_behind
    assert len(slots.move(rows, near).tint) > 0


def test_shapes_wait_for_a_change_that_has_them():
    shown = splatree.build_lod(scene(degree=0), splatree.BuildOptions(max_roots=4))
    slots, session = Slots(InMemory(shown), CENTRE, 2048), splatree.open_session(shown)
    rows = np.arange(0, len(shown), 3, dtype=np.int32)
    cameras = [splatree.Camera.look_at([0, 0, -z], [0, 0, 0], width=64, height=48) for z in (3.0, 30.0)]
    views = [(camera.position, session.view(camera)) for camera in cameras]
    slots.move(rows, *views[0])
    waiting = slots.move(rows, *views[1], has_shapes=False)
    assert len(waiting.shaped) == 0 and waiting.is_behind
    change = slots.move(rows, *views[1])
    assert len(change.shaped) > 0 and not change.is_behind


def test_the_slots_can_be_filled_to_the_last():
    slots, mirror = Slots(InMemory(scene()), CENTRE, 400), Mirror(400)
    for first in (0, 400, 800, 200):
        mirror.take(slots.move(np.arange(first, first + 400, dtype=np.int32), FAR))
        assert mirror.live.all()


def test_colours_follow_an_eye_that_moves_and_not_one_that_rests():
    shown = scene()
    slots, mirror = Slots(InMemory(shown), CENTRE, 512), Mirror(512)
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
    slots = Slots(InMemory(scene(degree=0)), CENTRE, 512)
    rows = np.arange(300, dtype=np.int32)
    slots.move(rows, FAR)
    assert len(slots.move(rows, -FAR).tint) == 0


def test_colours_of_many_nodes_come_in_parts(monkeypatch):
    monkeypatch.setattr(module, "TINTS", 100)
    slots = Slots(InMemory(scene()), CENTRE, 512)
    rows = np.arange(250, dtype=np.int32)
    slots.move(rows, FAR)
    sent, steps = 0, 0
    while True:
        change = slots.move(rows, -FAR)
        sent, steps = sent + len(change.tint), steps + 1
        if not change.is_behind:
            break
    assert (sent, steps) == (250, 3)


def test_the_oldest_colours_come_first_where_a_message_does_not_hold_all(monkeypatch):
    monkeypatch.setattr(module, "TINTS", 100)
    slots = Slots(InMemory(scene()), CENTRE, 512)
    rows = np.arange(250, dtype=np.int32)
    slots.move(rows, FAR)
    sent = []
    for step in range(5):  # each step leaves all colours behind
        angle = 1 + 2 * step
        sent.append(set(slots.move(rows, 9 * np.array([np.sin(angle), 0, np.cos(angle)])).tint.tolist()))
    assert all(len(each) == 100 for each in sent)
    assert len(sent[0] | sent[1] | sent[2]) == 250


def test_merged_nodes_come_as_they_look_and_come_again_when_that_changes():
    shown = splatree.build_lod(scene(degree=0), splatree.BuildOptions(max_roots=4))
    assert shown.tree.curves is not None
    slots, mirror = Slots(InMemory(shown), CENTRE, 2048), Mirror(2048)
    rows = np.arange(0, len(shown), 3, dtype=np.int32)
    inner = shown.tree.curves[rows, 2] > 0
    opacities = []
    for distance in (3.0, 3.01, 30.0):
        camera = splatree.Camera.look_at([0, 0, -distance], [0, 0, 0], width=64, height=48)
        change = slots.move(rows, camera.position, splatree.open_session(shown).view(camera))
        mirror.take(change)
        assert mirror.live.sum() == len(rows)
        depths = shown.gaussians.means[rows].astype(np.float64) @ camera.camera_from_world[2, :3] + distance
        h = 0.3 * depths**2 / camera.K[0, 0] ** 2
        scales = np.exp(shown.gaussians.log_scales[rows].astype(np.float64))
        _, wanted = follow(shown.tree.curves[rows].astype(np.float64), h, scales, shown.gaussians.opacities()[rows])
        found = (mirror.words[slots.slots, 3] >> 16) / 65535
        np.testing.assert_allclose(found[inner], wanted[inner], rtol=0.2)
        opacities.append(found[inner])
        assert len(change.add) == (len(rows) if distance == 3.0 else 0)
        if distance == 3.01:
            assert len(change.shaped) < 0.05 * len(rows)
        stored = pack_nodes(shown.gaussians, shown.tree, rows, camera.position, CENTRE).view(np.uint16)
        halves = mirror.words[slots.slots].view(np.uint16)
        kept = [0, 1, 2, 3, 4, 5, 6, 10, 11, 12]  # all but opacity, colour and scales
        np.testing.assert_array_equal(halves[:, kept], stored[:, kept])
    assert np.mean(opacities[2] - opacities[0]) > 0
