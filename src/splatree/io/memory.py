"""How much memory there is, what a user allows, and arrays that wait in files where that is too little."""

import contextlib
import ctypes
import math
import os
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from splatree.errors import InputError, OutputError
from splatree.io.objects import ObjectPath
from splatree.shapes import Array

__all__ = ["PROCESS_BYTES", "SMALLEST_MEMORY", "Scratch", "bytes_of", "free_bytes", "give_back_freed", "reserve"]

SMALLEST_MEMORY = 250_000_000
"""Bytes that may be asked for at least: less do not hold the program and some rows."""

PROCESS_BYTES = 130_000_000
"""What a process takes before it loads a row."""


@dataclass
class Scratch:
    """Room for what grows with the scene, and a folder for what has no room.

    Where the room is used up, arrays lie in files without a name, which are mapped: the system takes back their memory as it
    needs it, and their disk when the arrays are gone.
    """

    room: float
    """Bytes that are left."""
    folder: Path
    """Where the files are."""

    @staticmethod
    def beside(target: Path, max_memory: str | None) -> "Scratch":
        """For a file that is written, here or in a store, within what the user allows; None: half of what is free."""
        allowed = free_bytes() // 2 if max_memory is None else bytes_of(max_memory)
        is_elsewhere = isinstance(target, ObjectPath)
        return Scratch(max(0, allowed - PROCESS_BYTES), Path(tempfile.gettempdir()) if is_elsewhere else target.parent)

    @staticmethod
    def endless() -> "Scratch":
        """Room for everything."""
        return Scratch(math.inf, Path(tempfile.gettempdir()))

    def part(self, share: float) -> "Scratch":
        """A share of the room that is left, for arrays that are soon gone."""
        return Scratch(share * self.room, self.folder)

    def zeros(self, shape: tuple[int, ...], dtype: type) -> Array:
        """An array of zeros, in memory or in a file.

        Raises:
            OutputError: the disk has no room for it.
        """
        num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
        if num_bytes <= self.room:
            self.room -= num_bytes
            return np.zeros(shape, dtype)
        try:
            with tempfile.TemporaryFile(dir=self.folder) as file:
                reserve(file, num_bytes)
                return np.asarray(np.memmap(file, dtype, "r+", shape=shape))
        except OSError as error:
            raise OutputError(
                f"{self.folder}: found no room for {num_bytes / 1e6:.0f} MB that wait in a file ({error.strerror or error}); "
                "free some, or allow more memory with --max-memory"
            ) from error


def give_back_freed() -> None:
    """Let this process give large blocks of memory back when they are freed, where the C library is glibc.

    It keeps blocks of up to 32 MB for later, for each thread its own, once one of that size was freed: threads that make parts of
    a stream side by side held 50 MB so. The time is the same.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


_M_MMAP_THRESHOLD = -3  # malloc.h
_LARGE_BYTES = 1 << 18


def reserve(file: IO[bytes], num_bytes: int) -> None:
    """Give a new file so many bytes of zeros from where it is now, with their room on the disk.

    A file that is only said to be so large gets its room when its pages are written. If the disk is full then, a program that has
    mapped it is ended by a signal.

    Raises:
        OSError: the disk is full.
    """
    if sys.platform == "linux" and num_bytes > 0:
        os.posix_fallocate(file.fileno(), file.tell(), num_bytes)
        return
    zeros = bytes(min(num_bytes, 1 << 20))
    for begin in range(0, num_bytes, 1 << 20):
        file.write(zeros[: num_bytes - begin])
    file.flush()


def bytes_of(text: str) -> int:
    """The number of bytes that a text such as 4G, 500M (powers of 1000) or 4GiB (of 1024) says.

    Raises:
        InputError: it says none.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(?:([kmgt])(i?))?b?\s*", text, re.IGNORECASE)
    if match is None:
        raise InputError(f"memory: found {text!r}, wanted a number of bytes such as 4G, 500M or 4GiB")
    step = 1024 if match[3] else 1000
    return int(float(match[1]) * step ** " kmgt".index((match[2] or " ").lower()))


def free_bytes() -> int:
    """Bytes that processes may take without others having to give any up: of the machine, and of the control group."""
    return min(_free_of_machine(), _free_of_group())


def _free_of_group(folder: Path = Path("/sys/fs/cgroup")) -> int:
    """What the limit of a container leaves; what files back can be given up."""
    try:
        limit, used = (int((folder / name).read_text("utf-8")) for name in ("memory.max", "memory.current"))
        backed = re.search(r"^inactive_file (\d+)$", (folder / "memory.stat").read_text("utf-8"), re.MULTILINE)
    except (OSError, ValueError):  # no such group, or "max": no limit
        return sys.maxsize
    return max(0, limit - used + (int(backed[1]) if backed else 0))


def _free_of_machine() -> int:
    info = Path("/proc/meminfo")
    if info.exists() and (found := re.search(r"^MemAvailable:\s+(\d+) kB", info.read_text("utf-8"), re.MULTILINE)):
        return int(found[1]) * 1024
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows, macOS
        return 8 * 10**9
