"""Places and colours of a point cloud in a .ply, binary or text: the file that nerfstudio's transforms.json names."""

from pathlib import Path
from typing import Final

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.formats.ply.header import HEADER_MAX, parse_text
from splatree.shapes import Array, Float64, UInt8

__all__ = ["FARTHEST", "read_point_cloud"]

FARTHEST: Final = 1e18
"""Squares of places within this have room in float32."""

_PLACE, _COLOR = ("x", "y", "z"), ("red", "green", "blue")
_GREY = 128


def read_point_cloud(path: Path) -> tuple[Float64[Array, "n 3"], UInt8[Array, "n 3"]]:
    """Places and colours; grey where the file has none. Points whose place is no number, or has no room, are left out.

    Raises:
        InputError: there is no such file.
        FormatError: it is no .ply of points, or cut off.
    """
    if not path.is_file():
        raise InputError(f"{path}: not found; wanted a point cloud (.ply)")
    data = path.read_bytes()
    text = parse_text(path, data[:HEADER_MAX])
    vertex = text.elements[0] if text.elements else None
    if vertex is None or vertex.name != "vertex" or vertex.has_lists:
        raise FormatError(f"{path}: found no vertices at the beginning, wanted a table of points")
    types = dict(vertex.properties)
    if missing := [name for name in _PLACE if name not in types]:
        raise FormatError(f"{path}: found no property {' '.join(missing)}, wanted points with x y z")
    if text.encoding == "ascii":
        rows = [line.split() for line in data[text.num_bytes :].splitlines()[: vertex.count]]
        try:
            table = np.array(rows, np.float64).reshape(vertex.count, len(types))
        except ValueError as error:
            raise FormatError(
                f"{path}: found {len(rows)} rows, wanted {vertex.count} of {len(types)} numbers each; it is cut off or damaged"
            ) from error
        columns = dict(zip(types, table.T, strict=True))
    else:
        dtype = np.dtype(vertex.properties)
        if len(data) < text.num_bytes + vertex.count * dtype.itemsize:
            raise FormatError(
                f"{path}: found {len(data):,} bytes, wanted {text.num_bytes + vertex.count * dtype.itemsize:,}; it is cut off"
            )
        records = np.frombuffer(data, dtype, vertex.count, text.num_bytes)
        columns = {name: records[name].astype(np.float64) for name in types}
    places = np.stack([columns[name] for name in _PLACE], axis=1)
    colors = np.full((vertex.count, 3), _GREY, np.uint8)
    if all(name in types for name in _COLOR):
        unit = 255.0 if all("f" in types[name] for name in _COLOR) else 1.0  # floats are 0 to 1
        colors = np.rint(np.clip(unit * np.stack([columns[name] for name in _COLOR], axis=1), 0, 255)).astype(np.uint8)
    finite = (np.abs(places) <= FARTHEST).all(axis=1)
    return places[finite], colors[finite]
