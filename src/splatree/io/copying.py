"""Copy bytes that come one after the other into a file, up to a limit."""

import tempfile
from collections.abc import Callable
from typing import BinaryIO

from splatree.errors import FormatError, InputError

__all__ = ["TAKEN_MAX", "copied"]

TAKEN_MAX = 64 << 30
"""Bytes that are taken from a server or from standard input at most: a billion Gaussians without harmonics."""

_PIECE = 1 << 20


def copied(source: BinaryIO, target: BinaryIO, limit: int, where: str, advance: Callable[[float], None]) -> int:
    """Copy all bytes to a temporary file, at most ``limit`` of them; return how many.

    Raises:
        FormatError: there are more.
        InputError: the disk is full.
        OSError: the source breaks off.
    """
    size = 0
    while piece := source.read(_PIECE):
        size += len(piece)
        if size > limit:
            raise FormatError(
                f"{where}: becomes more than {limit:,} bytes, which no scene of this size does: a decompression bomb, or a file "
                "that never ends"
            )
        try:
            target.write(piece)
            target.flush()
        except OSError as error:  # which says nothing of the input
            raise InputError(
                f"{where}: cannot be kept in {tempfile.gettempdir()} while it is read ({error.strerror or error}); let TMPDIR "
                "name a folder with more room, or unpack it yourself"
            ) from error
        advance(len(piece))
    return size
