"""The thread pool, and the count of processors that it uses."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import splatree as st
from splatree.kernels.cpu import _core

from ..scenes import gaussians

PATIENCE_S = 60
"""A barrier that is not met fails after this time; nothing else depends on it."""


def test_every_chunk_runs_once():
    seen = []
    _core.run_chunks(100, 4, seen.append)
    assert sorted(seen) == list(range(100))


def test_jobs_of_two_callers_are_both_helped():
    _core.run_chunks(3, 3, lambda chunk: None)  # the pool has two workers from now on
    meetings = [threading.Barrier(2), threading.Barrier(2)]

    def job(meeting):
        # Both chunks have to run at the same time, on two threads.
        _core.run_chunks(2, 2, lambda chunk: meeting.wait(PATIENCE_S))

    with ThreadPoolExecutor(2) as callers:
        list(callers.map(job, meetings))


def test_a_job_that_starts_late_gets_workers_of_the_one_that_runs():
    _core.run_chunks(2, 2, lambda chunk: None)
    second_is_done = threading.Event()
    first_runs = threading.Event()
    meeting = threading.Barrier(2)

    def long_chunk(chunk):
        # The caller holds its chunk to the end; the worker has all the others, and leaves them for the second job.
        first_runs.set()
        if threading.current_thread() is callers[0]:
            assert second_is_done.wait(PATIENCE_S)

    def second():
        assert first_runs.wait(PATIENCE_S)
        _core.run_chunks(2, 2, lambda chunk: meeting.wait(PATIENCE_S))
        second_is_done.set()

    callers = [
        threading.Thread(target=lambda: _core.run_chunks(10_000, 2, long_chunk)),
        threading.Thread(target=second),
    ]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(PATIENCE_S)
    assert second_is_done.is_set()


def test_a_job_inside_a_chunk_of_another_ends():
    seen = []
    _core.run_chunks(4, 4, lambda outer: _core.run_chunks(4, 4, lambda inner: seen.append((outer, inner))))
    assert sorted(seen) == [(outer, inner) for outer in range(4) for inner in range(4)]


def test_an_error_in_a_chunk_reaches_the_caller():
    def fails(chunk):
        raise KeyError(f"chunk {chunk}")

    with pytest.raises(KeyError, match="chunk"):
        _core.run_chunks(8, 3, fails)
    test_every_chunk_runs_once()


def test_two_threads_that_draw_at_once_get_the_right_pictures():
    scenes = [st.Scene.flat(gaussians(20_000, seed)) for seed in (1, 2)]
    camera = st.Camera.look_at((0, 0, -6), (0, 0, 0), width=160, height=120)
    alone = [st.render(scene, camera, threads=1).image for scene in scenes]

    def draw(i):
        return [st.render(scenes[i % 2], camera, threads=4).image for _ in range(4)]

    with ThreadPoolExecutor(4) as callers:
        for i, pictures in enumerate(callers.map(draw, range(4))):
            for picture in pictures:
                assert picture.tobytes() == alone[i % 2].tobytes()


def test_splats_are_in_the_order_of_the_rows_for_any_number_of_threads():
    scene = st.Scene.flat(gaussians(60_000, 3))
    camera = st.Camera.look_at((0, 0, -6), (0, 0, 0), width=160, height=120)
    frames = [st.trace(scene, camera, threads=threads).splats for threads in (1, 2, 8)]
    assert np.all(np.diff(frames[0].rows) > 0)
    for splats in frames[1:]:
        assert splats.records.tobytes() == frames[0].records.tobytes()
        assert splats.rows.tobytes() == frames[0].rows.tobytes()


@pytest.mark.parametrize(
    ("membership", "files", "processors"),
    [
        ("0::/\n", {"cpu.max": "max 100000"}, 0),
        ("0::/\n", {"cpu.max": "400000 100000"}, 4),
        ("0::/\n", {"cpu.max": "150000 100000"}, 2),
        ("0::/\n", {"cpu.max": "5000 100000"}, 1),
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000", "a/cpu.max": "300000 100000"}, 3),
        ("0::/a/b\n", {"a/b/cpu.max": "200000 100000", "a/cpu.max": "300000 100000"}, 2),
        ("0::/docker/0123\n", {"cpu.max": "200000 100000"}, 2),  # the container's own group is the root that it sees
        (
            "12:memory:/a\n4:cpu,cpuacct:/a\n0::/\n",
            {"cpu,cpuacct/a/cpu.cfs_quota_us": "250000", "cpu,cpuacct/a/cpu.cfs_period_us": "100000"},
            3,
        ),
        ("4:cpu,cpuacct:/a\n", {"cpu/a/cpu.cfs_quota_us": "100000", "cpu/a/cpu.cfs_period_us": "50000"}, 2),
        ("4:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, 0),
        ("4:cpuset:/\n", {"cpuset/cpu.cfs_quota_us": "100000", "cpuset/cpu.cfs_period_us": "100000"}, 0),
        ("", {}, 0),
        ("nonsense\n::\n0::", {"cpu.max": "nonsense"}, 0),
    ],
)
def test_the_quota_of_control_groups_is_read(tmp_path: Path, membership, files, processors):
    (tmp_path / "membership").write_text(membership)
    for name, content in files.items():
        file = tmp_path / "mount" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content + "\n")
    assert _core.quota_processors(str(tmp_path / "membership"), str(tmp_path / "mount")) == processors


def test_control_groups_that_do_not_exist_set_no_limit(tmp_path: Path):
    assert _core.quota_processors(str(tmp_path / "none"), str(tmp_path / "none")) == 0
    assert _core.hardware_threads() >= 1


FORKED = """
import os
from splatree.kernels.cpu import _core
seen = []
_core.run_chunks(8, 4, seen.append)
child = os.fork()
if child == 0:
    _core.run_chunks(8, 4, seen.append)
    os._exit(0 if sorted(seen) == sorted(2 * list(range(8))) else 1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_child_has_a_pool_of_its_own():
    subprocess.run([sys.executable, "-W", "ignore", "-c", FORKED], check=True, timeout=PATIENCE_S)
