"""The rows of a .ply that is text: lines of numbers, whichever way lines end; empty ones count for nothing."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.errors import FormatError
from splatree.shapes import Array

__all__ = ["lines_of", "records_of"]

_BLOCK = 1 << 20

_LONGEST = 1 << 20
"""Bytes of a line: 300 numbers take 8 kB."""


def lines_of(path: Path, file: BinaryIO, start: int) -> Iterator[bytes]:
    """The lines from the byte ``start`` on, one after the other.

    Raises:
        FormatError: a line is longer than a row can be.
    """
    file.seek(start)
    rest = b""
    while block := file.read(_BLOCK):
        *lines, rest = re.split(rb"[\r\n]+", rest + block)
        yield from (line for line in lines if line.strip())
        if len(rest) > _LONGEST:
            raise FormatError(f"{path}: found a line of more than {_LONGEST} bytes, wanted rows of numbers")
    if rest.strip():
        yield rest


def records_of(path: Path, lines: list[bytes], dtype: np.dtype[np.void], first: int) -> Array:
    """Rows of numbers as records of doubles; ``first`` is the number of the first row.

    Raises:
        FormatError: a row has too few or too many values, or one that is no number.
    """
    names = dtype.names or ()
    rows = [line.split() for line in lines]
    wrong = next((i for i, row in enumerate(rows) if len(row) != len(names)), None)
    if wrong is not None:
        raise FormatError(
            f"{path}: vertex {first + wrong}: found {len(rows[wrong])} values, wanted {len(names)}; the file is cut off or "
            "damaged"
        )
    try:
        values = np.array(rows, "S").astype(np.float64)
    except ValueError as error:
        i, name, word = next(
            (i, name, word)
            for i, row in enumerate(rows)
            for name, word in zip(names, row, strict=True)
            if not _is_number(word)
        )
        found = word.decode("latin-1")
        raise FormatError(f"{path}: vertex {first + i}: found {name} {found!r}, wanted a number") from error
    records: Array = values.view([(name, "<f8") for name in names]).reshape(len(rows))
    return records


def _is_number(word: Any) -> bool:
    try:
        np.array(word, "S").astype(np.float64)
    except ValueError:
        return False
    return True
