import sys

import pytest

from splatree.kernels.cpu.runtime.files import reserve

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
