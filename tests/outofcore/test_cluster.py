"""Builds on a Dask cluster: the same files, whatever happens to its workers."""

import os
import signal
import socket
import threading
from dataclasses import replace

import pytest

import splatree as st
from splatree.outofcore import cluster as module
from splatree.outofcore.options import SMALLEST_MEMORY, Room, cell_bytes
from splatree.outofcore.work import Work

from .test_build_folder import files_in

distributed = pytest.importorskip("distributed", reason="the extra `dask` is not installed")


def on(address, **options):
    return st.FolderOptions(part_rows=200, scheduler=address, **options)


@pytest.fixture(scope="module")
def cluster():
    """Two processes of one thread each."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", memory_limit="1GB", silence_logs=50
    ) as cluster:
        cluster.wait_for_workers(2)
        yield cluster


@pytest.fixture(scope="module")
def address(cluster):
    return cluster.scheduler_address


@pytest.fixture(scope="module")
def here(tmp_path_factory, ply):
    """The files that a build of this process makes."""
    folder = tmp_path_factory.mktemp("here")
    st.build_folder(ply, folder / "here.splatree", running=st.FolderOptions(part_rows=200))
    return files_in(folder / "here.splatree")


def test_a_cluster_makes_the_same_files(tmp_path, ply, address, here):
    st.build_folder(ply, tmp_path / "there.splatree", running=on(address))
    assert files_in(tmp_path / "there.splatree") == here
    assert not (tmp_path / "there.splatree.work").exists()


def test_a_worker_that_is_killed_changes_nothing(tmp_path, ply, address, here):
    once = tmp_path / "killed"

    def patched():
        """On a worker: the first piece that grows is done but for its mark when the process dies."""
        from splatree.outofcore import run

        whole = run.KINDS["grow"].do

        def dying(*arguments):
            result = whole(*arguments)
            try:
                once.touch(exist_ok=False)
            except FileExistsError:
                return result
            os.kill(os.getpid(), signal.SIGKILL)

        run.KINDS["grow"] = replace(run.KINDS["grow"], do=dying)

    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2)
        before = set(client.run(os.getpid).values())
        client.run(patched)
    st.build_folder(ply, tmp_path / "there.splatree", running=on(address))
    assert files_in(tmp_path / "there.splatree") == here
    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=30)
        assert once.exists() and set(client.run(os.getpid).values()) != before


def test_a_cell_that_kills_one_worker_after_the_other_is_named(tmp_path, ply, cluster, monkeypatch):
    def dying(folder, run, kind, number, num_levels, threads):
        from splatree.outofcore.run import do_piece

        if (kind, number) == ("grow", 1):
            os.kill(os.getpid(), signal.SIGKILL)
        do_piece(folder, run, kind, number, num_levels, threads)

    monkeypatch.setattr("splatree.outofcore.run.do_piece", dying)
    monkeypatch.setattr(
        cluster.scheduler, "allowed_failures", 0
    )  # pieces that waited on the dead worker are counted too
    with pytest.raises(st.InputError, match=r"cells \[.*\b1\b.*\]: found that the processes which worked on them died"):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(cluster.scheduler_address))


def test_a_worker_that_computes_other_bits_or_is_of_another_version_is_refused(tmp_path, ply, address, monkeypatch):
    monkeypatch.setattr(module, "fingerprint", lambda: "0123")
    with pytest.raises(
        st.InputError, match=r"worker tcp://.*: found that it computes \w+ where this program computes 0123"
    ):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(address))
    monkeypatch.setattr(module, "program_version", lambda: "9.9")
    with pytest.raises(st.InputError, match=r"worker tcp://.*: found splatree .*, wanted 9\.9; install"):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(address))


def test_workers_that_cannot_be_asked_are_named(tmp_path, ply, address, monkeypatch):
    def without_splatree(token):
        raise ModuleNotFoundError("No module named 'splatree'")

    monkeypatch.setattr(module, "_answer", without_splatree)
    with pytest.raises(
        st.InputError, match=r"worker tcp://.*: found no splatree \(No module named 'splatree'\), wanted"
    ):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(address))
    monkeypatch.setattr(module, "_answer", lambda token: 1 / 0)
    with pytest.raises(st.InputError, match=r"worker tcp://.*: found ZeroDivisionError"):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(address))


def test_workers_have_to_see_the_folder(tmp_path, ply, address, monkeypatch):
    token = Work.token
    monkeypatch.setattr(module, "write_text", lambda path, text: path.write_text("of another machine"))
    with pytest.raises(st.InputError, match=r"found that it does not see .*out\.splatree\.work, wanted a folder"):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(address))
    assert not token.fget(Work(tmp_path / "out.splatree.work")).exists()


def test_an_address_without_a_cluster_is_told(tmp_path, ply, monkeypatch):
    def refused(address, message):
        with pytest.raises(st.InputError, match=message):
            st.build_folder(ply, tmp_path / "out.splatree", running=on(address))

    refused("here", "found 'here' .*wanted an address such as tcp://")
    refused("http://here:80", "found 'http://here:80' .*wanted an address such as tcp://")
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        refused(f"tcp://127.0.0.1:{closed.getsockname()[1]}", "found nothing that listens at tcp://127.0.0.1")
    monkeypatch.setattr(module, "PATIENCE_S", 0.5)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        there = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        refused(there, "does not greet as a Dask scheduler does")  # silent
        for words in (b"", b"SSH-2.0-OpenSSH_9.6\r\n"):
            refused_by = threading.Thread(target=lambda words=words: _say_and_close(other, words))
            refused_by.start()
            refused(there, "does not greet as a Dask scheduler does")
            refused_by.join()


def _say_and_close(listener, words):
    connection = listener.accept()[0]
    connection.sendall(words)
    connection.close()


def test_a_cluster_without_workers_is_told(tmp_path, ply, monkeypatch):
    monkeypatch.setattr(module, "PATIENCE_S", 0.5)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as empty,
        pytest.raises(st.InputError, match=r"found no worker at tcp://.*start some: dask worker"),
    ):
        st.build_folder(ply, tmp_path / "out.splatree", running=on(empty.scheduler_address))


def test_without_dask_the_extra_is_named(tmp_path, ply, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(st.MissingExtraError, match=r"'distributed': pip install 'splatree\[dask\]'"):
        st.build_folder(ply, tmp_path / "out.splatree", running=on("tcp://127.0.0.1:8786"))


def test_cells_are_cut_to_what_a_worker_holds():
    options = st.FolderOptions(max_memory="64G")
    assert Room.of(options, 10**9, 16).part_rows == 1_000_000
    room = Room.of(options, 10**9, 16, 600e6)
    assert cell_bytes(room.part_rows, 16) <= room.piece_bytes == 600e6 < cell_bytes(room.part_rows + 1, 16)
    with pytest.raises(st.InputError, match="found a worker with 100 MB for each of its threads, wanted at least"):
        Room.of(options, 10**9, 16, 100e6)
    assert SMALLEST_MEMORY > 100e6
    with pytest.raises(st.InputError, match="found 2 processes of this machine and a scheduler"):
        st.FolderOptions(workers=2, scheduler="tcp://here:1")
