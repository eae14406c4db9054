"""Builds through files: the tree of a build in memory, whatever stops and starts."""

import errno
import gzip
import json
import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.io.formats.folder.manifest import read_manifest
from splatree.io.memory import PROCESS_BYTES, _free_of_group, bytes_of
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.build.pairs import best_partners
from splatree.outofcore import build, crown, cut, follow, plan, run, shuffle
from splatree.outofcore.fingerprint import fingerprint
from splatree.outofcore.needs import needs_of
from splatree.outofcore.options import Room, cell_bytes
from splatree.progress import listen

from ..laws.hard_scenes import hard_scene, hard_scenes
from ..laws.test_parts import check_same_tree
from ..scenes import random_gaussians
from .conftest import check_is_drawn_as_the_whole_tree, small_pages

SMALL = st.FolderOptions(part_rows=200)
LITTLE = st.BuildOptions(radius=0.05, max_roots=1, follow=False)
TIERS = st.FolderOptions(part_rows=60, part_levels=2)
"""Cells so small that the levels above them are grown in cells, too, where memory is short."""


def room_for(num_roots):
    """Memory for so many roots of parts together, as long as the context lasts."""
    return mock.patch.object(build, "top_bytes", lambda roots, k, follows: 10**18 if roots > num_roots else 0)


def check_is_tree_of(folder, path, options=None, mode=None):
    scene = st.read(path)
    wanted = st.build_lod(scene, options)
    found = st.read(folder)
    check_same_tree(found, wanted)
    curves = np.zeros((len(wanted), 4), np.float32) if wanted.tree.curves is None else wanted.tree.curves
    assert found.tree.curves is None or found.tree.curves.tobytes() == curves.tobytes()
    assert wanted.tree.curves is None or found.tree.curves is not None
    assert found.source.metadata["levels"] == wanted.source.metadata["levels"]
    assert found.mode == wanted.mode
    return found


@settings(max_examples=12, deadline=None)
@given(
    gaussians=hard_scenes(most=300, degree=1),
    part_rows=hs.sampled_from([16, 60, 1000]),
    part_levels=hs.integers(1, 4),
    radius=hs.sampled_from(["auto", 0.15]),
    max_roots=hs.sampled_from([1, 64]),
    most_together=hs.sampled_from([20, 10**9]),
    follows=hs.sampled_from([True, True, False]),
    at_once=hs.sampled_from([(3, 2), (10, 20), (follow.PIECE_ROWS, follow.PASS_LEAVES)]),
)
def test_the_tree_is_that_of_a_build_in_memory(
    tmp_path_factory, gaussians, part_rows, part_levels, radius, max_roots, most_together, follows, at_once
):
    path = tmp_path_factory.mktemp("scene") / "in.ply"
    st.write(st.Scene.flat(gaussians), path)
    options = st.BuildOptions(radius=radius, max_roots=max_roots, follow=follows)
    running = st.FolderOptions(part_rows=part_rows, part_levels=part_levels)
    rows, leaves = at_once
    with (
        room_for(max(most_together, max_roots)),
        mock.patch.object(follow, "PIECE_ROWS", rows),
        mock.patch.object(follow, "PASS_LEAVES", leaves),
    ):
        built = st.build_folder(path, path.with_name("out.splatree"), options, running)
    found = check_is_tree_of(built.path, path, options)
    assert (built.num_gaussians, built.num_nodes) == (len(gaussians), len(found))
    assert sorted(p.name for p in path.parent.iterdir()) == ["in.ply", "out.splatree"]


def test_several_inputs_are_one_scene(tmp_path, ply):
    built = st.build_folder([ply, ply], tmp_path / "out.splatree", running=SMALL)
    check_is_tree_of(built.path, [ply, ply])
    assert any("joined as one scene" in note for note in built.notes)


def files_in(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_files_do_not_depend_on_who_makes_them(tmp_path, ply):
    st.build_folder(ply, tmp_path / "a.splatree", running=SMALL)
    with ThreadPoolExecutor(3) as executor:
        st.build_folder(ply, tmp_path / "b.splatree", running=SMALL, executor=executor)
    assert files_in(tmp_path / "a.splatree") == files_in(tmp_path / "b.splatree")


def test_processes_of_this_machine_make_the_same_files(tmp_path, ply):
    st.build_folder(ply, tmp_path / "a.splatree", running=SMALL)
    st.build_folder(ply, tmp_path / "b.splatree", running=st.FolderOptions(part_rows=200, workers=2, max_memory="2G"))
    assert files_in(tmp_path / "a.splatree") == files_in(tmp_path / "b.splatree")


class StopError(Exception):
    """What interrupts a build in the tests."""


@pytest.mark.parametrize("pieces", [0, 5])
def test_an_interrupted_build_goes_on_where_it_stopped(tmp_path, ply, monkeypatch, pieces):
    done, do_piece = [], run.do_piece

    def stopping(*job):
        if len(done) == pieces:
            raise StopError
        done.append(job)
        do_piece(*job)

    monkeypatch.setattr(run, "do_piece", stopping)
    with pytest.raises(StopError):
        st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    assert not (tmp_path / "out.splatree").exists()
    assert (tmp_path / "out.splatree.work" / "plan.json").exists()

    again, events = [], []
    monkeypatch.setattr(run, "do_piece", lambda *job: (again.append(job), do_piece(*job)))
    monkeypatch.setattr(shuffle, "_make_slice", None)  # all slices are there
    with listen(events.append):
        st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    of_cells = [event for event in events if event.name == "put cells in order"]
    assert (of_cells[0].done > 0) == (pieces > 0)  # rows of the first run
    assert {event.total for event in of_cells} == {700} and of_cells[-1].done == 700
    assert not {job[2:4] for job in again} & {job[2:4] for job in done}
    check_is_tree_of(tmp_path / "out.splatree", ply)
    assert [path.name for path in tmp_path.iterdir()] == ["out.splatree"]


def test_ctrl_c_is_left_to_the_program_and_its_workers_end_without_a_word():
    """A terminal sends it to all processes: workers used to print where they were, those that were just starting too."""
    others = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt), run.Workers(2).pool() as executor:
        started = set(multiprocessing.active_children()) - others
        assert executor is not None and len(started) == 2
        executor.submit(signal.raise_signal, signal.SIGINT).result()  # in a worker
        if sys.platform != "win32":
            assert signal.SIGINT in executor.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
            assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
        busy = executor.submit(time.sleep, 600)
        waiting = [executor.submit(time.sleep, 600) for _ in range(5)]
        raise KeyboardInterrupt
    for process in started:
        process.join(60)
        for _ in range(1000):  # the pool's own thread has taken its end, and is about to say so
            if process.exitcode is None:
                time.sleep(0.01)
        assert process.exitcode == -signal.SIGTERM
    assert all(future.cancelled() or future.exception(60) for future in (busy, *waiting))


def _build_and_die(ply, output, pieces, options=None, running=SMALL):
    """In a process of its own: a build that is killed while it works."""
    left, do_piece = [pieces], run.do_piece

    def dying(*job):
        do_piece(*job)
        left[0] -= 1
        if not left[0]:
            (output.with_name(output.name + ".work") / "cells" / ".00000.splatree.00000000.splatree.tmp").write_bytes(
                b"x"
            )
            os.kill(os.getpid(), signal.SIGKILL)

    run.do_piece = dying
    st.build_folder(ply, output, options, running)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_a_killed_build_goes_on(tmp_path, ply):
    context = multiprocessing.get_context("fork")
    process = context.Process(target=_build_and_die, args=(ply, tmp_path / "out.splatree", 6))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    check_is_tree_of(tmp_path / "out.splatree", ply)
    st.build_folder(ply, tmp_path / "whole.splatree", running=SMALL)
    assert files_in(tmp_path / "out.splatree") == files_in(tmp_path / "whole.splatree")


@pytest.fixture(scope="module")
def of_five_tiers(tmp_path_factory, ply):
    """The files of a build whose levels above the parts are grown in cells, tier by tier."""
    folder = tmp_path_factory.mktemp("tiers") / "whole.splatree"
    with room_for(20):
        st.build_folder(ply, folder, LITTLE, TIERS)
    check_is_tree_of(folder, ply, LITTLE)
    return files_in(folder)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("pieces", [30, 55])  # of 24 in the first tier, 19, 12 and 2 in those above, and the crown
def test_a_build_that_is_killed_above_its_parts_goes_on(tmp_path, ply, of_five_tiers, pieces):
    target = tmp_path / "out.splatree"
    with room_for(20):
        context = multiprocessing.get_context("fork")
        process = context.Process(target=_build_and_die, args=(ply, target, pieces, LITTLE, TIERS))
        process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        assert len(folders_of_tiers(tmp_path / "out.splatree.work")) > 1
        st.build_folder(ply, target, LITTLE, TIERS)
    assert files_in(target) == of_five_tiers


def _build_and_die_at_rename(ply, output, number):
    """In a process of its own: a build that is killed when it is about to give a file its name."""
    left, names = [number], {name: getattr(Path, name) for name in ("replace", "rename")}

    def dying(name):
        def rename(self, target):
            left[0] -= 1
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)
            return names[name](self, target)

        return rename

    for name in names:
        setattr(Path, name, dying(name))
    st.build_folder(ply, output, running=SMALL)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("number", [7, 8, 9])  # a piece has at most four files, the end of this build six
def test_a_build_that_is_killed_again_and_again_ends_with_the_same_files(tmp_path, ply, number):
    context = multiprocessing.get_context("fork")
    exit_codes = []
    while not exit_codes or exit_codes[-1] != 0:
        process = context.Process(target=_build_and_die_at_rename, args=(ply, tmp_path / "out.splatree", number))
        process.start()
        process.join()
        exit_codes.append(process.exitcode)
        assert exit_codes[-1] in (0, -signal.SIGKILL) and len(exit_codes) < 40
    assert len(exit_codes) > 4
    st.build_folder(ply, tmp_path / "whole.splatree", running=SMALL)
    assert files_in(tmp_path / "out.splatree") == files_in(tmp_path / "whole.splatree")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.splatree", "whole.splatree"]


def test_what_a_build_left_when_it_was_killed_at_its_end_is_not_used(tmp_path, ply, monkeypatch):
    monkeypatch.setattr("splatree.outofcore.work.Work.clear", lambda self: None)
    st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    assert (tmp_path / "out.splatree.work").exists()
    monkeypatch.undo()
    st.build_folder(ply, tmp_path / "out.splatree", running=SMALL, force=True)
    check_is_tree_of(tmp_path / "out.splatree", ply)
    assert [path.name for path in tmp_path.iterdir()] == ["out.splatree"]


def test_what_another_scene_left_is_not_used(tmp_path, ply, monkeypatch):
    other = tmp_path / "other.ply"
    st.write(st.Scene.flat(hard_scene(400, "clusters", 8, degree=1)), other)
    monkeypatch.setattr(run, "do_piece", None)
    with pytest.raises(TypeError):
        st.build_folder(other, tmp_path / "out.splatree", running=SMALL)
    monkeypatch.undo()
    st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    check_is_tree_of(tmp_path / "out.splatree", ply)


def test_a_program_that_computes_other_bits_is_refused(tmp_path, ply, monkeypatch):
    monkeypatch.setattr(run, "fingerprint", lambda: "0123")
    with pytest.raises(st.InputError, match="found that it computes 0123 where the build began with"):
        st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)


def test_a_program_whose_costs_have_other_bits_is_another():
    before = _core.isa()
    costs, prints = {}, {}
    rows = random_gaussians(300, seed=1)
    try:
        for isa in _core.isas():
            _core.use_isa(isa)
            _, found, _ = best_partners(rows, np.ones(300, np.float32), dilation=0.0)
            costs[isa], prints[isa] = found.tobytes(), fingerprint.__wrapped__()
    finally:
        _core.use_isa(before)
    for one, other in combinations(costs, 2):
        assert (prints[one] == prints[other]) == (costs[one] == costs[other])


def test_what_a_program_of_other_bits_left_is_not_gone_on_with(tmp_path, ply, monkeypatch):
    monkeypatch.setattr(build, "finish_scene", None)
    with monkeypatch.context() as other, pytest.raises(TypeError):
        for module in (plan, run, cut):
            other.setattr(module, "fingerprint", lambda: "0123")
        st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    monkeypatch.undo()
    made = []
    monkeypatch.setattr(cut, "make_plan", lambda *given: made.append(given) or plan.make_plan(*given))
    st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    assert len(made) == 1
    check_is_tree_of(tmp_path / "out.splatree", ply)


def test_outputs_are_replaced_only_with_force(tmp_path, ply):
    target = tmp_path / "out.splatree"
    st.build_folder(ply, target, running=SMALL)
    with pytest.raises(st.OutputError, match="exists already"):
        st.build_folder(ply, target, running=SMALL)
    st.build_folder(ply, target, st.BuildOptions(radius=0.4), SMALL, force=True)
    check_is_tree_of(target, ply, st.BuildOptions(radius=0.4))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("keep me")
    with pytest.raises(st.OutputError, match="not the folder of a scene"):
        st.build_folder(ply, tmp_path / "mine", running=SMALL, force=True)
    with pytest.raises(st.OutputError, match="there is no folder"):
        st.build_folder(ply, tmp_path / "none" / "out.splatree", running=SMALL)


def test_what_cannot_be_built_is_refused_before_any_work(tmp_path, ply):
    tree = tmp_path / "tree.rad"
    st.write(st.build_lod(st.read(ply)), tree)
    with pytest.raises(st.InputError, match="not read in chunks"):
        st.build_folder(tree, tmp_path / "a.splatree")
    st.write(st.Scene.flat(st.Gaussians.empty()), tmp_path / "empty.ply")
    with pytest.raises(st.InputError, match="found 0 Gaussians"):
        st.build_folder(tmp_path / "empty.ply", tmp_path / "a.splatree")
    numbers = ({"workers": 0}, {"workers": 1025}, {"part_rows": 0}, {"part_levels": 0})
    for wrong in (*numbers, {"max_memory": "9M"}, {"max_memory": "much"}):
        with pytest.raises(st.InputError, match="wanted"):
            st.FolderOptions(**wrong)


def test_a_cell_that_cannot_be_cut_and_does_not_fit_is_named(tmp_path, monkeypatch):
    st.write(st.Scene.flat(hard_scene(900, "one place", 1)), tmp_path / "in.ply")
    built = st.build_folder(tmp_path / "in.ply", tmp_path / "out.splatree", running=SMALL)  # it fits: one cell
    check_is_tree_of(built.path, tmp_path / "in.ply")
    monkeypatch.setattr("splatree.outofcore.cut.cell_bytes", lambda rows, k, *, by_pairs, follows: rows * 10**9)
    with pytest.raises(st.InputError, match="cell 0: found 900 Gaussians so close together that they cannot be cut"):
        st.build_folder(tmp_path / "in.ply", tmp_path / "more.splatree", running=SMALL)


def test_memory_is_spent_on_rows_then_on_processes():
    said = ("4G", "1.5 g", "250MB", "9", "4GiB", "512 kib", "1Ti")
    wanted = [4 * 10**9, 1500 * 10**6, 250 * 10**6, 9, 4 << 30, 512 << 10, 1 << 40]
    assert [bytes_of(text) for text in said] == wanted
    for wrong in ("4ib", "50%", "G", "-1G"):
        with pytest.raises(st.InputError, match=rf"memory: found '{wrong}', wanted a number of bytes such as 4G"):
            bytes_of(wrong)
    for memory in ("250M", "500M", "1G", "4G"):
        for k in (1, 16):
            room = Room.of(st.FolderOptions(max_memory=memory, workers=3), 10**9, k)
            assert room.workers * cell_bytes(room.part_rows, k) <= bytes_of(memory)
    assert Room.of(st.FolderOptions(max_memory="64G", workers=3), 10**9, 16) == Room(
        64 * 10**9, 1_000_000, 3, 64 * 10**9
    )
    cramped = st.FolderOptions(
        max_memory="1G", workers=3
    )  # processes for cells of a thousand rows, one for a full cell
    assert [Room.of(cramped, rows, 16).workers for rows in (1000, 10**9)] == [3, 1]


def test_a_container_has_what_its_limit_leaves(tmp_path):
    unlimited = _free_of_group(tmp_path)  # there is no group
    (tmp_path / "memory.max").write_text("4000000000\n")
    (tmp_path / "memory.current").write_text("3000000000\n")
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 500000000\nactive_file 7\n")
    assert _free_of_group(tmp_path) == 1_500_000_000
    (tmp_path / "memory.max").write_text("max\n")
    assert _free_of_group(tmp_path) == unlimited > 2**62


def test_what_a_build_needs_is_known_from_the_heads(tmp_path, ply, monkeypatch):
    monkeypatch.setattr("splatree.outofcore.needs.free_bytes", lambda: 200_000_000)
    needs = needs_of([ply, ply], st.ReadOptions(repair=True))
    assert needs.num_bytes == PROCESS_BYTES + 1400 * (550 + 3 * 30) and needs.are_large
    (tmp_path / "scene.ply.gz").write_bytes(gzip.compress(ply.read_bytes()))
    assert needs_of([tmp_path / "scene.ply.gz"], st.ReadOptions()) is None  # it would have to be unpacked
    monkeypatch.setattr("splatree.outofcore.needs.free_bytes", lambda: 10**12)
    monkeypatch.setattr("splatree.outofcore.needs.opened_chunks", None)
    assert needs_of([ply], st.ReadOptions()) is None  # whatever it holds, it is small


def folders_of_tiers(folder):
    """The folders of a build that is under way: each is the work on the levels above the one before."""
    found = [folder]
    while (found[-1] / "above" / "plan.json").exists():
        found.append(found[-1] / "above")
    return found


@pytest.mark.parametrize(("most", "num_tiers"), [(10**9, 2), (500, 3), (100, 4), (20, 5)])
def test_what_does_not_fit_above_the_parts_is_grown_in_cells_of_its_own(tmp_path, ply, monkeypatch, most, num_tiers):
    monkeypatch.setattr("splatree.outofcore.work.Work.clear", lambda self: None)
    with room_for(most):
        built = st.build_folder(ply, tmp_path / "out.splatree", LITTLE, TIERS)
    check_is_tree_of(built.path, ply, LITTLE)
    tiers = folders_of_tiers(tmp_path / "out.splatree.work")
    assert len(tiers) == num_tiers
    cells = [len(json.loads((tier / "plan.json").read_text())["cells"]) + 1 for tier in tiers]
    assert cells[-1] == 1 and all(below >= above for below, above in pairwise(cells[1:]))  # of roots


def test_a_crown_of_many_tiers_is_drawn_from_disk_as_the_whole_tree(tmp_path, ply):
    with room_for(20), small_pages(60):
        built = st.build_folder(ply, tmp_path / "out.splatree", LITTLE, TIERS)
        st.check(built.path)
    check_is_drawn_as_the_whole_tree(built.path)


def test_an_end_that_does_not_fit_is_told(tmp_path, ply):
    with room_for(0), pytest.raises(st.InputError, match="which do not fit in"):
        st.build_folder(ply, tmp_path / "never.splatree", LITTLE, SMALL)


def test_a_full_disk_is_told_and_the_build_goes_on_later(tmp_path, ply, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(st.OutputError, match="No space left on device"):
        st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    monkeypatch.undo()
    st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)
    check_is_tree_of(tmp_path / "out.splatree", ply)


def test_a_part_that_vanished_from_the_work_is_told(tmp_path, ply, monkeypatch):
    finish = crown.finish_scene

    def without_part(tiers, *arguments):
        (tiers[0].work.scene / "parts" / "00001.splatree").unlink()
        return finish(tiers, *arguments)

    monkeypatch.setattr("splatree.outofcore.build.finish_scene", without_part)
    with pytest.raises(st.InputError, match=r"00001\.splatree: found another file than was written, or none"):
        st.build_folder(ply, tmp_path / "out.splatree", running=SMALL)


@pytest.fixture
def built(tmp_path, ply):
    return st.build_folder(ply, tmp_path / "city.splatree", running=SMALL).path


def test_a_flipped_byte_is_found(built):
    part = built / "parts" / "00001.splatree"
    data = bytearray(part.read_bytes())
    data[-5] ^= 1
    part.write_bytes(data)
    with pytest.raises(st.FormatError, match=r"00001\.splatree: found digest .*damaged or of another build"):
        st.read(built)


def test_a_part_that_is_cut_off_or_missing_is_found(built):
    part = built / "parts" / "00001.splatree"
    part.write_bytes(part.read_bytes()[:-5])
    with pytest.raises(st.FormatError, match=r"00001\.splatree: found \d+ bytes, wanted \d+"):
        st.read(built)
    part.unlink()
    with pytest.raises(st.FormatError, match=r"00001\.splatree: cannot be read"):
        st.read(built)


HOSTILE = {
    "version 2": (lambda m: m.update(version=2), "version: found 2"),
    "out of the folder": (lambda m: m["parts"][0].update(name="../scene.ply"), "wanted a relative path inside"),
    "absolute": (lambda m: m["parts"][0].update(name="/etc/passwd"), "wanted a relative path inside"),
    "a size": (lambda m: m["parts"][0].update(num_bytes=-1), "wanted a whole number"),
    "no size": (lambda m: m["parts"][0].pop("num_bytes"), "found no key 'num_bytes'"),
    "twice": (lambda m: m["parts"].append(m["parts"][0]), "named twice"),
    "one less": (lambda m: m["parts"].pop(), "rows and"),
    "swapped": (lambda m: m["parts"].reverse(), "not those of the crown"),
    "rows": (lambda m: m.update(num_rows=7), "wanted 7"),
    "too many rows": (lambda m: m.update(num_rows=2**31), "less than 2^31"),
    "no parts": (lambda m: m.update(parts=[]), "found 0 parts"),
    "a digest": (lambda m: m["crown"].update(digest="00"), "found digest"),
    "a list": (lambda m: m.update(crown=[]), "wanted an object"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_manifest_is_refused(built, what):
    change, message = HOSTILE[what]
    manifest = json.loads((built / "manifest.json").read_text())
    change(manifest)
    (built / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(st.InputError) as error:
        st.read(built)
    assert message in str(error.value) and "city.splatree" in str(error.value)


def test_a_folder_is_drawn_as_the_tree_in_memory(built, ply):
    scene, wanted = st.read(built), st.build_lod(st.read(ply))
    camera = st.orbit(wanted, st.PathOptions(views=1, width=64, height=48))[0]
    for pixel_error in (0.0, 3.0, 20.0):
        options = st.SelectOptions(pixel_error=pixel_error)
        np.testing.assert_array_equal(st.select(scene, camera, options).rows, st.select(wanted, camera, options).rows)
        pictures = [st.render(each, camera, select=options).image for each in (scene, wanted)]
        assert pictures[0].tobytes() == pictures[1].tobytes()


def test_formats_that_are_not_read_in_chunks_are_named_as_the_user_did(tmp_path, ply):
    st.write(st.build_lod(st.read(ply)), tmp_path / "a.rad")
    with pytest.raises(
        st.InputError, match=r"^.*a\.rad: found a format that is not read in chunks; convert it to \.ply first"
    ):
        st.build_folder(tmp_path / "a.rad", tmp_path / "parts.splatree")


@pytest.mark.parametrize("follows", [False, True])
def test_leaves_of_the_crown_are_copies_of_roots(tmp_path, ply, follows):
    """Their extents, shapes and curves too, whatever the tier that they were grown in."""
    with room_for(20), small_pages(60):
        built = st.build_folder(ply, tmp_path / "out.splatree", replace(LITTLE, follow=follows), TIERS)
    crown = st.read(built.path / "crown.splatree")
    parts = [st.read(built.path / file.name) for file in read_manifest(built.path).parts]
    copies = np.flatnonzero(crown.tree.is_leaf)
    roots = [(part, np.flatnonzero(part.tree.depth == 0)) for part in parts]
    assert len(parts) > 1 and len(copies) == sum(len(rows) for _, rows in roots)
    for name in ("extents", "curves") if follows else ("extents",):
        of_roots = np.concatenate([getattr(part.tree, name)[rows] for part, rows in roots])
        assert getattr(crown.tree, name)[copies].tobytes() == of_roots[crown.ids[copies]].tobytes()
    scales = np.concatenate([part.gaussians.log_scales[rows] for part, rows in roots])
    assert crown.gaussians.log_scales[copies].tobytes() == scales[crown.ids[copies]].tobytes()
