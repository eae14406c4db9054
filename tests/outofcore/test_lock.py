"""One process at a time works in a folder, whatever ends it."""

import errno
import fcntl
import json
import multiprocessing
import os
import signal
import socket

import pytest

import splatree as st
from splatree.outofcore import run
from splatree.outofcore.lock import LOCK, alone_in
from splatree.outofcore.mapped import mapped_whole

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has neither SIGKILL nor fork")

FORK = multiprocessing.get_context("fork")
SMALL = st.FolderOptions(part_rows=200)


def _build_and_wait(ply, output, pipe, verb):
    """In a process of its own: work that stops in its second piece until it may go on."""
    left, do_piece = [2], run.do_piece

    def waiting(*job):
        left[0] -= 1
        if not left[0]:
            pipe.send("begun")
            pipe.recv()
        do_piece(*job)

    run.do_piece = waiting
    verb(ply, output)


def build(ply, output):
    return st.build_folder(ply, output, st.BuildOptions(method="radius"), SMALL)


def thin(ply, output):
    return st.thin_file(ply, output, st.ThinOptions(radius=0.2), SMALL)


@pytest.fixture
def beside(ply, tmp_path):
    """Begins work on an output in another process, which goes on when it is sent a word."""
    here, there = FORK.Pipe()
    processes = []

    def begin(verb, name):
        processes.append(FORK.Process(target=_build_and_wait, args=(ply, tmp_path / name, there, verb)))
        processes[0].start()
        assert here.poll(60) and here.recv() == "begun"
        return processes[0], here

    yield begin
    for process in processes:
        process.kill()
        process.join()


@pytest.mark.parametrize(("verb", "name"), [(build, "out.splatree"), (thin, "out.ply")])
def test_a_second_process_is_told_who_works_there(tmp_path, ply, beside, verb, name):
    process, pipe = beside(verb, name)
    for _ in range(2):
        with pytest.raises(
            st.OutputError, match=rf"{name}\.work: found that process {process.pid} of this machine works"
        ):
            verb(ply, tmp_path / name)
    pipe.send("go on")
    process.join()
    assert process.exitcode == 0
    assert [path.name for path in tmp_path.iterdir()] == [name]
    verb(ply, tmp_path / f"other_{name}")
    if name == "out.ply":
        assert (tmp_path / name).read_bytes() == (tmp_path / f"other_{name}").read_bytes()


@pytest.mark.parametrize(("verb", "name"), [(build, "out.splatree"), (thin, "out.ply")])
def test_the_work_of_a_killed_process_is_taken_over(tmp_path, ply, beside, verb, name):
    process, _ = beside(verb, name)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    lock = tmp_path / f"{name}.work" / LOCK
    assert json.loads(lock.read_text()) == {"pid": process.pid, "host": socket.gethostname()}
    verb(ply, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_folder_that_is_put_together_is_not_taken_for_a_build(tmp_path, folder, beside):
    process, _ = beside(build, "out.splatree")
    with (
        pytest.raises(st.OutputError, match=rf"process {process.pid} of this machine"),
        mapped_whole(folder, tmp_path / "out.splatree"),
    ):
        pass
    with mapped_whole(folder, tmp_path / "stream") as scene:
        assert len(scene) > 0 and sorted(path.name for path in (tmp_path / "stream.work").iterdir()) == [
            LOCK,
            "whole.splatree",
        ]
    assert not (tmp_path / "stream.work").exists()


def _enter_again_and_again(folder, times):
    """In one of several processes: exit with 0 if no other was ever inside at the same time."""
    entered = 0
    while entered < times:
        try:
            with alone_in(folder):
                os.close(os.open(folder / "inside", os.O_CREAT | os.O_EXCL))
                (folder / "inside").unlink()
                entered += 1
        except st.OutputError:
            pass


def test_of_many_processes_one_is_inside(tmp_path):
    processes = [FORK.Process(target=_enter_again_and_again, args=(tmp_path / "work", 200)) for _ in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(120)
    assert [process.exitcode for process in processes] == [0, 0, 0, 0]
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_another_machine_is_not_taken_over(tmp_path, ply):
    work = tmp_path / "out.splatree.work"
    work.mkdir()
    (work / LOCK).write_text('{"pid": 7, "host": "elsewhere"}')
    with pytest.raises(
        st.OutputError, match=r"work/lock: found that process 7 of elsewhere works there.*delete this file"
    ):
        build(ply, tmp_path / "out.splatree")
    with (work / LOCK).open() as held:  # where locks of other machines are seen
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(st.OutputError, match=r"out\.splatree\.work: found that process 7 of elsewhere works there"):
            build(ply, tmp_path / "out.splatree")
    (work / LOCK).unlink()
    build(ply, tmp_path / "out.splatree")
    assert [path.name for path in tmp_path.iterdir()] == ["out.splatree"]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"pid": "x", "host": 3}'])
def test_a_file_that_names_nobody_is_taken_over(tmp_path, text):
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / LOCK).write_text(text)
    with alone_in(tmp_path / "work"):
        assert json.loads((tmp_path / "work" / LOCK).read_text())["pid"] == os.getpid()
    assert list(tmp_path.iterdir()) == []


def test_without_locks_of_the_system_the_file_counts(tmp_path, monkeypatch):
    def unsupported(*_):
        raise OSError(errno.ENOSYS, "no locks")

    monkeypatch.setattr(fcntl, "flock", unsupported)
    cannot_see = pytest.raises(st.OutputError, match="cannot see from here whether it still does")
    with alone_in(tmp_path / "work"), cannot_see, alone_in(tmp_path / "work"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_build_lets_go_of_its_folder(tmp_path, ply, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "do_piece", interrupted)
    with pytest.raises(KeyboardInterrupt):
        build(ply, tmp_path / "out.splatree")
    names = [path.name for path in (tmp_path / "out.splatree.work").iterdir()]
    assert "plan.json" in names and LOCK not in names


def test_a_folder_that_was_deleted_meanwhile_is_left_to_who_made_it_anew(tmp_path):
    work = tmp_path / "work"
    with alone_in(work):
        (work / LOCK).unlink()
        work.rmdir()
        with alone_in(work):
            pass
        work.mkdir()
        (work / LOCK).write_text("of another process")
    assert (work / LOCK).read_text() == "of another process"
    (tmp_path / "file").write_text("")
    with pytest.raises(st.OutputError, match="file: cannot be made a folder"), alone_in(tmp_path / "file"):
        pass
