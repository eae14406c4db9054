import sys

import numpy as np
import pytest

from splatree.kernels.cpu.runtime.files import reserve, write_at

TOO_MUCH = 1 << 61
"""Bytes; no disk has them."""


def test_a_file_has_its_size_before_it_is_written(tmp_path):
    path = tmp_path / "a"
    with path.open("wb", buffering=0) as file:
        reserve(file, 10_000)
        file.write(b"abc")
    content = path.read_bytes()
    assert content[:3] == b"abc" and not any(content[3:])
    assert len(content) == 10_000 or sys.platform != "linux"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux is asked for room")
def test_a_full_disk_is_told_before_the_work(tmp_path):
    with (tmp_path / "a").open("wb", buffering=0) as file, pytest.raises(OSError, match=r"No space left|too large"):
        reserve(file, TOO_MUCH)


def test_nothing_to_reserve_is_no_error(tmp_path):
    with (tmp_path / "a").open("wb", buffering=0) as file:
        reserve(file, 0)
        with pytest.raises(ValueError, match="no less than 0"):
            reserve(file, -1)
    assert (tmp_path / "a").stat().st_size == 0


def test_bytes_are_written_at_their_place(tmp_path):
    path = tmp_path / "a"
    with path.open("wb", buffering=0) as file:
        write_at(file, 4, np.arange(3, dtype=np.uint16)[::-1])
        write_at(file, 0, b"abcd")
        write_at(file, 2, b"")
    assert path.read_bytes() == b"abcd\2\0\1\0\0\0"
    with path.open("rb") as file, pytest.raises(OSError, match="Bad file descriptor"):
        write_at(file, 0, b"a")
