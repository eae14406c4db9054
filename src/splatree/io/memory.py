"""How much memory there is, what a user allows, and arrays that wait in files where that is too little."""

import math
import os
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.errors import InputError
from splatree.io.objects import ObjectPath
from splatree.shapes import Array

__all__ = ["PROCESS_BYTES", "SMALLEST_MEMORY", "Scratch", "bytes_of", "free_bytes"]

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

    def zeros(self, shape: tuple[int, ...], dtype: type) -> Array:
        """An array of zeros, in memory or in a file."""
        num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
        if num_bytes <= self.room:
            self.room -= num_bytes
            return np.zeros(shape, dtype)
        with tempfile.TemporaryFile(dir=self.folder) as file:
            return np.asarray(np.memmap(file, dtype, "w+", shape=shape))


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
