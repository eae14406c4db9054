"""The bytes of elements before the vertices, also of those that hold lists, and binary values that were taken for text."""

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.errors import FormatError
from splatree.io.formats.ply.header import Element

__all__ = ["bytes_of", "refuse_converted_lines"]

_BYTES_OF_SAMPLE = 1 << 20
_FEEDS_MIN = 4
"""Line feeds that must follow carriage returns: by chance they do so in one file of 2^32."""


def bytes_of(file: BinaryIO, start: int, elements: list[Element], path: Path) -> int:
    """How many bytes ``elements`` of a binary file take from the byte ``start`` on.

    Raises:
        FormatError: the file ends within them.
    """
    at, size = start, path.stat().st_size
    for element in elements:
        if element.has_lists:
            at = _after_lists(file, at, element, size, path)
        else:
            at += element.num_bytes
        if at > size:
            raise FormatError(
                f"{path}: found {size} bytes, which end within the element {element.name!r}; it is cut off"
            )
    return at - start


def refuse_converted_lines(file: BinaryIO, start: int, path: Path) -> None:
    """Refuse a binary file that is too long and in which, from the byte ``start`` on, every line feed follows a carriage return.

    Raises:
        FormatError: it is so.
    """
    file.seek(start)
    values = file.read(_BYTES_OF_SAMPLE)
    feeds = values.count(b"\n")
    if feeds >= _FEEDS_MIN and values.count(b"\r\n") == feeds:
        raise FormatError(
            f"{path}: found a carriage return before each line feed of its binary values, and more bytes than its header "
            "announces: a transfer in text mode or a tool for texts has changed them; fetch the file again, as binary"
        )


def _after_lists(file: BinaryIO, at: int, element: Element, size: int, path: Path) -> int:
    """Where an element with lists ends, row by row; a row takes at least the counts of its lists."""
    scalars, layout = iter(element.properties), list[tuple[np.dtype[Any] | None, int]]()
    for place in range(len(element.properties) + len(element.lists)):
        if place in element.lists:
            count_type, item_type = (np.dtype(name) for name in element.lists[place])
            layout.append((count_type, item_type.itemsize))
        else:
            layout.append((None, np.dtype(next(scalars)[1]).itemsize))
    least = sum(width if number is None else number.itemsize for number, width in layout)
    if element.count * least > size - at:
        raise FormatError(f"{path}: found {size} bytes, too few for the {element.count} rows of {element.name!r}")
    file.seek(at)
    data = file.read()
    place = 0
    for _ in range(element.count):
        for number, width in layout:
            if number is None:
                place += width
                continue
            if place + number.itemsize > len(data):
                raise FormatError(f"{path}: ends within the lists of the element {element.name!r}; it is cut off")
            count = int(np.frombuffer(data, number, 1, place)[0])
            if count < 0:
                raise FormatError(f"{path}: found a list of {count} items in the element {element.name!r}")
            place += number.itemsize + count * width
    return at + place
