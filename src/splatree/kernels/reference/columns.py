"""Interleaved records into float32 columns, and the largest magnitude of a column: what the fast kernels must give."""

from collections.abc import Sequence

import numpy as np

from splatree.shapes import Array


def deinterleave(
    records: Array, fields: Sequence[Sequence[str]], columns: Sequence[Array], *, threads: int = 0
) -> None:
    """Copy fields of ``records`` "n" (a structured array) into float32 ``columns`` "n w", one list of w fields a column."""
    for names, column in zip(fields, columns, strict=True):
        for j, name in enumerate(names):
            column[:, j] = records[name].astype(np.float32)


def largest_magnitude(values: Array, *, threads: int = 0) -> float:
    """Largest ``|value|`` of a float32 array of any shape; NaN if one is NaN, 0 if it is empty."""
    return float(np.abs(values).max(initial=0))
