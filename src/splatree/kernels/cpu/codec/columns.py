"""Interleaved records into float32 columns and back, and the extremes of a column, at the speed of memory."""

from collections.abc import Sequence
from functools import lru_cache
from typing import BinaryIO

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array

_SCALARS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")  # order of enum Scalar


def deinterleave(
    file: BinaryIO,
    start: int,
    record: np.dtype[np.void],
    fields: Sequence[Sequence[str]],
    columns: Sequence[Array],
    *,
    threads: int = 0,
) -> list[float]:
    """Read records from byte ``start`` of a file into float32 ``columns`` "n w", one list of w fields a column.

    Values are converted to float32 as C does. A field may appear in several columns; the others are left out. Returns the
    largest magnitude of each column.

    Raises:
        EOFError: the file ends before the last record.
        OSError: it cannot be read.
    """
    offsets, types = _places(record, tuple(map(tuple, fields)))
    try:
        found = _core.deinterleave(file.fileno(), start, record.itemsize, offsets, types, list(columns), threads)
    except RuntimeError as error:
        raise EOFError(str(error)) from error
    return [float(magnitude) for magnitude in found]


def interleave(columns: Sequence[Array], fields: Sequence[Sequence[str]], records: Array, *, threads: int = 0) -> None:
    """Write float32 ``columns`` "n w" into the named float32 fields of the first n of ``records``; others keep their bytes."""
    offsets, types = _places(records.dtype, tuple(map(tuple, fields)))
    _core.interleave(records.itemsize, offsets, types, list(columns), records.view(np.uint8), threads)


@lru_cache(maxsize=16)
def _places(record: np.dtype[np.void], fields: tuple[tuple[str, ...], ...]) -> tuple[Array, Array]:
    """Byte in the record and type of each value, column by column."""
    assert record.fields is not None
    flat = [record.fields[name] for names in fields for name in names]
    offsets = np.array([offset for _, offset, *_ in flat], np.int64)
    return offsets, np.array([_SCALARS.index(scalar.str[1:]) for scalar, *_ in flat], np.uint8)


def largest_magnitude(values: Array, *, threads: int = 0) -> float:
    """Largest ``|value|`` of a float32 array of any shape; NaN if one is NaN, 0 if it is empty."""
    return float(_core.largest_magnitude(values.reshape(-1), threads))


def shortest(vectors: Array, *, threads: int = 0) -> float:
    """Length of the shortest float32 vector "n 4"; infinity if there are none. One with a NaN is passed over."""
    return float(_core.shortest(vectors, threads))
