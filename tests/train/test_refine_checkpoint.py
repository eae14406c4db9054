"""A refinement that stops leaves a whole scene, and goes on with the same bits, or says why it cannot."""

import errno
import itertools
import os
from contextlib import nullcontext
from dataclasses import fields, replace
from importlib import import_module

import numpy as np
import pytest

import splatree as st
from splatree.kernels.devices import training_stages_of
from splatree.train import school
from splatree.train.checkpoint import Identity, load, save
from splatree.train.lessons import made_views

from ..scenes import surface
from .test_checkpoint import rewrite, stop_after

OPTIONS = st.RefineOptions(iterations=40, made_views=8)


@pytest.fixture(scope="module")
def tree():
    return st.build_lod(st.Scene.flat(surface(600, degree=1)), st.BuildOptions("pairs"))


@pytest.fixture(scope="module")
def refine(tree):
    """Refine in small pictures."""
    cameras = [camera.scaled(0.2) for camera in made_views(tree, 8, 0)]
    return lambda scene=tree, options=OPTIONS, cameras=cameras, **more: st.refine(
        scene, options, cameras=cameras, threads=1, **more
    )


@pytest.fixture(scope="module")
def whole(refine):
    """A run that was not stopped."""
    return refine()


def bits(refined):
    """All that a refined scene holds."""
    g, tree = refined.scene.gaussians, refined.scene.tree
    columns = [getattr(g, field.name) for field in fields(st.Gaussians)] + [tree.curves, tree.extents, tree.subtree_end]
    return [column.tobytes() for column in columns], refined.scene.source.metadata["refined"]


@pytest.mark.parametrize("step", [1, 13, 20, 39])
def test_a_run_that_stopped_goes_on_with_the_same_bits(refine, whole, tmp_path, step):
    folder = tmp_path / "a.run"
    stopped = refine(files=st.RunFiles(folder), stop=stop_after(step))
    assert stopped.stopped and stopped.iterations == step
    resumed = refine(files=st.RunFiles(folder, resume=True))
    assert not resumed.stopped and resumed.iterations == 40 and resumed.num_learned == whole.num_learned
    assert bits(resumed) == bits(whole)
    np.testing.assert_array_equal(resumed.after, whole.after)


def test_what_was_learned_until_a_stop_is_a_whole_scene(refine, tree, tmp_path):
    stopped = refine(files=st.RunFiles(tmp_path / "a.run"), stop=stop_after(38))
    assert stopped.gain > 0 and 0 < stopped.num_learned <= stopped.num_nodes
    assert '"stopped": true' in stopped.scene.source.metadata["refined"]
    is_leaf = tree.tree.is_leaf
    for field in fields(st.Gaussians):
        a, b = getattr(tree.gaussians, field.name), getattr(stopped.scene.gaussians, field.name)
        np.testing.assert_array_equal(a[is_leaf], b[is_leaf])


def test_a_run_that_ended_has_nothing_to_go_on_with(refine, whole, tmp_path):
    folder = tmp_path / "a.run"
    refine(files=st.RunFiles(folder))
    assert [path.name for path in folder.iterdir()] == ["checkpoint.npz"]
    steps = []
    again = refine(files=st.RunFiles(folder, resume=True), stop=lambda: bool(steps.append(1)))
    assert bits(again) == bits(whole) and not steps


def test_as_many_steps_as_minutes_allowed_give_the_same_bits(refine, tmp_path, monkeypatch):
    """Stopped before the clock is read, and after."""
    ticks = itertools.count()
    monkeypatch.setattr(school.time, "process_time", lambda: 0.01 * next(ticks))  # a step takes 20 ms
    quick = replace(OPTIONS, iterations=None, minutes=2 / 60)
    first = refine(options=quick)
    assert school.TIMED + 3 < first.iterations < 120
    assert bits(first) == bits(refine(options=replace(OPTIONS, iterations=first.iterations)))
    for step in (7, school.TIMED + 1):
        folder = tmp_path / f"{step}.run"
        assert refine(options=quick, files=st.RunFiles(folder), stop=stop_after(step)).iterations == step
        resumed = refine(options=quick, files=st.RunFiles(folder, resume=True))
        assert school.TIMED + 3 < resumed.iterations < 120
        assert bits(resumed) == bits(refine(options=replace(OPTIONS, iterations=resumed.iterations)))


def test_a_run_is_written_down_on_the_way(refine, whole, tmp_path, monkeypatch):
    """A program that is killed loses what came after the last mark, and no more."""
    folder, made = tmp_path / "a.run", []
    step = school.School._step

    def killed(self, *given):
        made.append(1)
        if len(made) == 25:
            raise KeyboardInterrupt
        step(self, *given)

    with monkeypatch.context() as patch:
        patch.setattr(school.School, "_step", killed)
        with pytest.raises(KeyboardInterrupt):
            refine(files=st.RunFiles(folder))
    made.clear()
    monkeypatch.setattr(school.School, "_step", lambda self, *given: made.append(1) or step(self, *given))
    resumed = refine(files=st.RunFiles(folder, resume=True))
    assert bits(resumed) == bits(whole) and len(made) == 20  # from one half on


@pytest.fixture
def begun(refine, tmp_path):
    """A run that was stopped."""
    folder = tmp_path / "a.run"
    refine(files=st.RunFiles(folder), stop=stop_after(3))

    return lambda **more: refine(files=st.RunFiles(folder, resume=True), **more)


def test_other_options_are_refused_by_name(begun):
    with pytest.raises(
        st.InputError, match=r"checkpoint.npz: the run was begun with rate 1.0, found 2.0; go on with the"
    ):
        begun(options=replace(OPTIONS, rate=2.0))
    with pytest.raises(st.InputError, match=r"begun with iterations 40, found 50"):
        begun(options=replace(OPTIONS, iterations=50))


def test_another_scene_and_other_cameras_are_refused(begun, tree):
    g = tree.gaussians
    for column in (field.name for field in fields(st.Gaussians)):
        changed = getattr(g, column).copy()
        changed.reshape(-1)[-1] += np.float32(0.01)
        scene = replace(tree, gaussians=replace(g, **{column: changed}), blocks=None)
        with pytest.raises(
            st.InputError, match=r"input 'scene' has changed since the run was begun; go on with the same inputs"
        ):
            begun(scene=scene)
    with pytest.raises(st.InputError, match=r"input 'scene' has changed"):
        begun(scene=replace(tree, tree=replace(tree.tree, extents=tree.tree.extents * np.float32(1.01)), blocks=None))
    with pytest.raises(st.InputError, match=r"input 'cameras' has changed"):
        begun(cameras=made_views(tree, 8, 1))
    assert begun().iterations == 40


def test_damaged_checkpoints_and_those_of_others_are_refused(begun, tmp_path):
    path = tmp_path / "a.run" / "checkpoint.npz"
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole[:100] + b"x" * 4000 + whole[4100:]):
        path.write_bytes(damaged)
        with pytest.raises(st.FormatError, match=r"checkpoint.npz: not a whole checkpoint"):
            begun()
    for change, kind, said in (
        ({"version": 2}, st.InputError, r"found version 2, wanted 3; begin the run again"),
        ({"command": "train"}, st.InputError, r"found a run of train, wanted one of refine"),
        ({"step": -5}, st.FormatError, r"checkpoint.npz.step: found -5"),
        ({"wanted": "a"}, st.FormatError, r"checkpoint.npz.wanted: found 'a'"),
        ({"timed_s": float("nan")}, st.FormatError, r"checkpoint.npz.timed_s: found NaN"),
    ):
        path.write_bytes(whole)
        rewrite(path, change)
        with pytest.raises(kind, match=said):
            begun()
    path.unlink()
    with pytest.raises(st.InputError, match=r"checkpoint.npz: not found"):
        begun()


def test_a_full_disk_leaves_the_last_checkpoint_whole(begun, tmp_path, monkeypatch):
    path = tmp_path / "a.run" / "checkpoint.npz"
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half of it")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(st.OutputError, match=r"checkpoint.npz: could not be written \(No space left on device\)"):
            begun()
    assert path.read_bytes() == before and [entry.name for entry in path.parent.iterdir()] == ["checkpoint.npz"]
    assert begun().iterations == 40


def test_runs_that_cannot_be_kept_or_replayed_are_refused_before_the_first_step(refine, tmp_path):
    (tmp_path / "file").write_text("")
    steps = []
    for folder in (tmp_path / "none" / "a.run", tmp_path / "file"):
        with pytest.raises(st.OutputError, match=f"{folder.name}: cannot be made a folder for the run"):
            refine(files=st.RunFiles(folder), stop=lambda: bool(steps.append(1)))
    with pytest.raises(st.InputError, match="found a log to replay, wanted none"):
        refine(files=st.RunFiles(replay=tmp_path / "log.json"))
    assert not steps


def test_no_folder_is_left_by_a_run_that_ends_before_the_first_step(refine, tmp_path, monkeypatch):
    """As when the user interrupts twice while the teacher is drawn."""

    def interrupted(*given, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("splatree.train.refine"), "lessons_of", interrupted)
    with pytest.raises(KeyboardInterrupt):
        refine(files=st.RunFiles(tmp_path / "a.run"))
    assert not (tmp_path / "a.run").exists()


def test_options_and_scenes_of_numpys_values_go_on_as_pythons_own(tree, refine, tmp_path):
    options = st.RefineOptions(
        iterations=np.int64(4),
        made_views=np.int32(8),
        finest=np.float32(3),
        rate=np.float32(1),
        teacher=np.str_("same"),
    )
    record = replace(tree.tree.record, profile=np.str_(tree.tree.record.profile))
    scene = replace(tree, tree=replace(tree.tree, record=record), mode=np.str_(tree.mode))
    files = st.RunFiles(tmp_path / "a.run")
    assert refine(scene, options, files=files, stop=stop_after(2)).iterations == 2
    resumed = refine(tree, replace(OPTIONS, iterations=4), files=replace(files, resume=True))
    assert resumed.iterations == 4


def test_single_damaged_bytes_are_told_with_the_name_of_the_file(tmp_path):
    """Of the first head, of the first in the list of members, and of its end: signatures, versions, flags, methods, sizes."""
    identity = Identity("refine", {"a": 1}, {"scene": "x"})
    save(tmp_path, identity, {"steps": np.zeros(1, np.uint16)}, {})
    path, refused = tmp_path / "checkpoint.npz", 0
    whole = path.read_bytes()
    listed = whole.index(b"PK\x01\x02")
    places = [*range(40), *range(listed, listed + 60), *range(len(whole) - 22, len(whole))]
    for i, flip in itertools.product(places, (0x01, 0x80)):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ flip]) + whole[i + 1 :])
        try:
            load(tmp_path, identity, lambda arrays, about, where: arrays["steps"])
        except st.FormatError as error:
            assert str(error).startswith(str(path))
            refused += 1
    assert refused > len(places) // 2


@pytest.mark.parametrize("name", ["means", "quats", "moments", "steps"])
def test_checkpoints_of_other_rows_are_refused(begun, tmp_path, name):
    path = tmp_path / "a.run" / "checkpoint.npz"
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **arrays | {name: arrays[name][:-1]})
    with pytest.raises(st.FormatError, match=rf"checkpoint.npz: {name}: found shape .*, wanted"):
        begun()
    np.savez(path, **arrays | {name: arrays[name].astype(np.int8)})
    with pytest.raises(st.FormatError, match=r"checkpoint.npz: not a whole checkpoint \(.*: found dtype int8"):
        begun()


@pytest.mark.parametrize("change", [{"options": [1]}, {"digests": "none"}, {"command": ["train"]}])
def test_checkpoints_that_say_other_things_are_refused(begun, tmp_path, change):
    rewrite(tmp_path / "a.run" / "checkpoint.npz", change)
    with pytest.raises(st.FormatError, match=rf"checkpoint.npz.{next(iter(change))}: found"):
        begun()


def test_options_that_are_lists_are_told_as_others(begun, tmp_path):
    rewrite(tmp_path / "a.run" / "checkpoint.npz", {"options": {"minutes": [1.0]}})
    with pytest.raises(st.InputError, match=r"begun with minutes \[1.0\], found 1.0"):
        begun()


@pytest.fixture
def timed(tree, monkeypatch):
    """Learn 50 steps that are timed, without drawing: what the bar was told, the steps that were kept, how it ended."""

    def learn(stop=lambda: False, wanted=None, step=0):
        told, marks = [], []
        with monkeypatch.context() as patch:
            patch.setattr(school, "task", lambda *given: nullcontext(told.append))
            patch.setattr(school.School, "_step", lambda *given: None)
            ticks = itertools.count()
            patch.setattr(
                school.time, "process_time", lambda: next(ticks)
            )  # a step takes 1 s, and the clock 1 s a look
            pupils, course = school.School(tree, training_stages_of("cpu"), 1), school.Course(wanted, step)
            end = 2 * school.TIMED + 30.5
            stopped = pupils.learn([None], OPTIONS, course, end, stop=stop, keep=lambda: marks.append(course.step))
        return told, marks, stopped, course

    return learn


def test_the_bar_of_a_timed_run_ends_full_and_no_mark_is_skipped(timed):
    told, marks, stopped, course = timed()
    assert (course.wanted, course.step, stopped) == (50, 50, False)
    assert sum(told) == pytest.approx(1) and not any(told[: school.TIMED])
    assert marks == [21, 25, 38]  # 10 and 25 % have gone by when the number of steps is known
    told, marks, _, _ = timed(wanted=50, step=10)
    assert sum(told) == pytest.approx(1) and marks == [13, 25, 38]  # 10 % was kept by the run that stopped


def test_a_stop_at_the_last_step_interrupts_nothing(timed):
    assert timed(stop=stop_after(49))[2] and timed(stop=stop_after(5))[2]
    assert not timed(stop=stop_after(50))[2] and not timed(stop=stop_after(40), wanted=40)[2]
