"""Room on the disk for a file that is about to be written."""

from typing import BinaryIO

from splatree.kernels.cpu import _core

__all__ = ["reserve"]


def reserve(file: BinaryIO, num_bytes: int) -> None:
    """Set room aside for all bytes of a file open for writing; it gets that size.

    A full disk is told before the work, and writing costs a third less. Nothing happens where the system has no such call.

    Raises:
        OSError: there is not as much room.
    """
    _core.reserve(file.fileno(), num_bytes)
