"""Room on the disk for a file that is about to be written, and bytes at places of it, on every system."""

from typing import BinaryIO

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array

__all__ = ["reserve", "write_at"]


def reserve(file: BinaryIO, num_bytes: int) -> None:
    """Set room aside for all bytes of a file open for writing; it gets that size.

    A full disk is told before the work, and writing costs a third less. Nothing happens where the system has no such call.

    Raises:
        OSError: there is not as much room.
    """
    _core.reserve(file.fileno(), num_bytes)


def write_at(file: BinaryIO, offset: int, data: bytes | Array) -> None:
    """Write all bytes at a place of an open, unbuffered file; several threads may write to different places at once.

    Raises:
        OSError: the system refuses.
    """
    flat = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else np.ascontiguousarray(data)
    if flat.size:
        _core.write_at(file.fileno(), flat.reshape(-1).view(np.uint8), offset)
