"""What must hold of every file that is read, and changes of bytes that make such files."""

import gzip
import random
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from splatree import SplatreeError, read
from splatree.io.check import checked

MEMORY_ALWAYS = 64 << 20
"""Bytes that any read may take: tables of pictures alone are 3 MB, a million Gaussians without harmonics 56 MB …"""

MEMORY_PER_BYTE = 600
"""… and for each byte of the file: flat pictures and deflate hold up to 16 and 4 Gaussians of 236 bytes in a byte or four."""


def read_once(target: Path, data: bytes) -> None:
    """Read the target with these bytes: it must give a scene that can be drawn or one of our errors, in little memory."""
    target.write_bytes(data)
    is_measured = zlib.crc32(data) % 4 == 0  # it takes as long as two readings
    if is_measured:
        tracemalloc.start()
    try:
        scene = read(target.parent if target.suffix == ".json" else target, repair=len(data) % 3 == 0)
    except SplatreeError as error:
        assert str(error), "an error without words"
    else:
        checked(scene, "accepted", repair=False)
        assert np.isfinite(scene.tree.extents).all(), "extents"
    finally:
        peak = tracemalloc.get_traced_memory()[1] if is_measured else 0
        tracemalloc.stop()
    assert peak <= MEMORY_ALWAYS + MEMORY_PER_BYTE * len(data), f"{peak} bytes of memory for a file of {len(data)}"


def with_odd_number(data: bytes, numbers: random.Random) -> bytes:
    """Put a number at which code goes wrong where a byte other than 0 stands: headers are mostly zeros, counts are not."""
    places = [i for i, byte in enumerate(data[:16384]) if byte] or [0]
    width = numbers.choice((1, 2, 4, 8))
    at = numbers.choice(places) // width * width
    odd = (0, 1, 2, 255, -1, -2, 2**31 - 1, 2**31, 2**15, 2**24, 2**53, numbers.getrandbits(64))
    value = (numbers.choice(odd) & (2 ** (8 * width) - 1)).to_bytes(width, "little")
    if width >= 4 and numbers.random() < 0.3:
        value = np.array(numbers.choice((np.nan, np.inf, -np.inf, 1e38, -1.0, 1e-40)), "<f4").tobytes()
    return data[:at] + value + data[at + len(value) :]


def through_compression(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Change the content of a gzip file; of other files the bytes."""
    if data[:2] == b"\x1f\x8b":
        try:
            return gzip.compress(change(gzip.decompress(data)), 1)
        except (OSError, EOFError, zlib.error):
            return change(data)
    return change(data)
