"""Interleaved records into float32 columns and back, and the extremes of a column: what the fast kernels must give."""

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from splatree.shapes import Array


def deinterleave(
    file: BinaryIO,
    start: int,
    record: np.dtype[np.void],
    fields: Sequence[Sequence[str]],
    columns: Sequence[Array],
    *,
    threads: int = 0,
) -> list[float]:
    """Read records from byte ``start`` of a file into float32 ``columns`` "n w"; return their largest magnitudes."""
    file.seek(start)
    data = file.read(record.itemsize * len(columns[0]))
    if len(data) < record.itemsize * len(columns[0]):
        raise EOFError("the file ends before its last record")
    records = np.frombuffer(data, record)
    for names, column in zip(fields, columns, strict=True):
        for j, name in enumerate(names):
            column[:, j] = records[name].astype(np.float32)
    return [largest_magnitude(column) for column in columns]


def interleave(columns: Sequence[Array], fields: Sequence[Sequence[str]], records: Array, *, threads: int = 0) -> None:
    """Write float32 ``columns`` "n w" into the named fields of the first n of ``records``."""
    for names, column in zip(fields, columns, strict=True):
        for j, name in enumerate(names):
            records[name][: len(column)] = column[:, j]


def largest_magnitude(values: Array, *, threads: int = 0) -> float:
    """Largest ``|value|`` of a float32 array of any shape; NaN if one is NaN, 0 if it is empty."""
    return float(np.abs(values).max(initial=0))


def shortest(vectors: Array, *, threads: int = 0) -> float:
    """Length of the shortest float32 vector "n 4"; infinity if there are none. One with a NaN is passed over."""
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(vectors.astype(np.float64), axis=1)
    return float(lengths[~np.isnan(lengths)].min(initial=np.inf))
