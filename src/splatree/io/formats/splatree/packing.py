"""Whole numbers as few bytes: the tables of a compact ``.splatree``.

Codes around 0 are folded to 0, 1, 2, … (0, −1, 1, −2, …), so that small ones have high bytes of 0. They are stored planar, all
rows' first value before all rows' second, in the narrowest type that holds them all, the lowest bytes of all values first; then
deflated.
"""

import zlib

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.shapes import Array, Int64

__all__ = ["WIDTHS", "pack", "unpack"]

WIDTHS = (1, 2, 4)
"""Bytes of a code that tables may have."""

_CODE_MAX = 2.0**31 - 1


def pack(values: Array, name: str) -> tuple[bytes, int]:
    """Numbers "n d", rounded, as bytes; and the bytes of one.

    Raises:
        InputError: a number is not finite or beyond 31 bits.
    """
    within = np.abs(values) < _CODE_MAX
    if not within.all():
        row = int(np.argmin(within.all(axis=1)))
        raise InputError(
            f"compact, {name}: found {values[row]} quanta between merged node {row} and what its leaves suggest, wanted at most "
            "2^31; write the scene without `compact`"
        )
    codes = np.rint(values).astype(np.int64)
    folded = ((codes << 1) ^ (codes >> 63)).astype(np.uint32)
    width = next(w for w in WIDTHS if int(folded.max(initial=0)) < 256**w)
    planes = np.ascontiguousarray(folded.T).reshape(-1).astype(f"<u{width}").view(np.uint8).reshape(-1, width).T
    return zlib.compress(np.ascontiguousarray(planes).tobytes(), 6), width


def unpack(data: bytes, num_rows: int, num_values: int, width: int, where: str) -> Int64[Array, "n d"]:
    """The codes "n d" that `pack` packed.

    Raises:
        FormatError: the bytes are damaged or hold another number of codes.
    """
    folded = np.frombuffer(inflated(data, num_rows * num_values * width, where), np.uint8).reshape(width, -1).T
    values = np.ascontiguousarray(folded).view(f"<u{width}").reshape(num_values, num_rows).T.astype(np.int64)
    return np.ascontiguousarray((values >> 1) ^ -(values & 1))


def inflated(data: bytes, num_bytes: int, where: str) -> bytes:
    """Exactly so many bytes, and no more memory than they take.

    Raises:
        FormatError: there are fewer or more, or the stream is damaged.
    """
    stream = zlib.decompressobj()
    try:
        found = stream.decompress(data, num_bytes + 1)  # a limit of 0 would be none
    except zlib.error as error:
        raise FormatError(f"{where}: cannot be inflated ({error}); the file is damaged") from error
    if len(found) != num_bytes or not stream.eof or stream.unused_data:
        raise FormatError(f"{where}: found {len(found)} bytes or more, wanted exactly {num_bytes}; the file is damaged")
    return found
