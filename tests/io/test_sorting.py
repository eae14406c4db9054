"""Records in the order of their keys: as one sort of all of them gives them, whatever the room."""

import errno
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as hs

from splatree.errors import OutputError
from splatree.io import memory
from splatree.io.memory import Scratch
from splatree.io.sorting import Sorter


@given(
    seed=hs.integers(0, 2**32 - 1),
    n=hs.integers(0, 700),
    values=hs.sampled_from([1, 2, 30, 2**64 - 1]),
    room=hs.sampled_from([0, 5_000, 1 << 30]),
)
def test_runs_are_those_of_one_stable_sort(tmp_path_factory, seed, n, values, room):
    rng = np.random.default_rng(seed)
    keys = rng.integers(0, values, n, np.uint64, endpoint=True)
    records = rng.integers(0, 256, (n, 5), np.uint8)
    order = np.argsort(keys, kind="stable")
    with Sorter(n, 5, keys[::3], Scratch(room, tmp_path_factory.getbasetemp())) as sorter:
        for begin in range(0, n, 64):
            sorter.put(keys[begin : begin + 64], records[begin : begin + 64])
        for rows_at_once in (50, 1000):  # as often as it is asked for
            runs = list(sorter.runs(rows_at_once))
            assert [len(found) for found, _ in runs[:-1]] == [rows_at_once] * (len(runs) - 1)
            found = [np.concatenate(part) for part in zip(*runs, strict=True)] or [keys, records]
            np.testing.assert_array_equal(found[0], keys[order])
            np.testing.assert_array_equal(found[1], records[order])


@pytest.mark.parametrize("room", [0, 10**9])
def test_scratch_is_zero_and_leaves_no_file(tmp_path, room):
    scratch = Scratch(room, tmp_path)
    arrays = [scratch.zeros((100, 3), np.float32), scratch.zeros((0,), np.int32)]
    assert not arrays[0].any() and arrays[1].shape == (0,)
    arrays[0][:] = 1
    assert (scratch.room, list(tmp_path.iterdir())) == (max(0, room - 1200), [])


def test_a_full_disk_is_an_error_and_no_signal(tmp_path, monkeypatch):
    """What waits in a mapped file has its room on the disk before it is written."""
    with (tmp_path / "a").open("w+b") as file:
        file.write(b"head")
        memory.reserve(file, 3_000_001)
        file.flush()
        assert os.fstat(file.fileno()).st_size == 3_000_005
        assert os.fstat(file.fileno()).st_blocks * 512 >= 3_000_005  # none of it is a hole
    assert not Scratch(0, tmp_path).zeros((1000, 2), np.int32).any()

    def full(file, num_bytes):
        raise OSError(errno.ENOSPC, f"No space left on device for {num_bytes}")

    monkeypatch.setattr(memory, "reserve", full)
    with pytest.raises(OutputError, match=r"found no room for 1 MB that wait in a file \(No space left .* 1048576\)"):
        Scratch(0, tmp_path).zeros((1 << 18,), np.int32)


def test_where_room_cannot_be_reserved_zeros_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(memory.sys, "platform", "darwin")
    with (tmp_path / "a").open("w+b") as file:
        file.write(b"head")
        memory.reserve(file, 3_000_001)
        assert (tmp_path / "a").stat().st_size == 3_000_005
