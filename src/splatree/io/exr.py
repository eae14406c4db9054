"""OpenEXR pictures of float32 planes: what an 8-bit picture cannot hold, such as depth.

One part of scan lines without compression (OpenEXR 2.0, "File layout"): magic, version, attributes, a table with the place of
each line, the lines. Channels stand in the alphabetical order of their names, line by line.
"""

import os
import struct
from collections.abc import Mapping

import numpy as np

from splatree.errors import ShapeError
from splatree.io.replacing import replacing
from splatree.shapes import Array, Float32

__all__ = ["SOFTWARE", "write_exr"]

SOFTWARE = "splatree"
"""What pictures say wrote them."""

_MAGIC, _VERSION, _FLOAT, _NO_COMPRESSION = 20000630, 2, 2, 0


def write_exr(
    planes: Mapping[str, Float32[Array, "h w"]], path: str | os.PathLike[str], *, force: bool = False
) -> None:
    """Write float32 planes by the names of their channels: "Z" for depth, "A" for alpha, "R", "G", "B".

    Raises:
        ShapeError: there is no plane, or they differ in shape or have no pixel.
        OutputError: the file exists and ``force`` is not set, or it cannot be written.
    """
    shapes = {np.shape(plane) for plane in planes.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2 or 0 in next(iter(shapes)):
        raise ShapeError(
            f"write_exr: found planes of shapes {sorted(shapes)}, wanted one shape (h w) with at least one pixel"
        )
    height, width = next(iter(shapes))
    names = sorted(planes)
    lines = np.stack([np.asarray(planes[name], "<f4") for name in names], axis=1)  # [h channels w]
    channels = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", _FLOAT, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = (
        ("channels", "chlist", channels),
        ("compression", "compression", bytes([_NO_COMPRESSION])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
        ("software", "string", SOFTWARE.encode()),
    )
    head = struct.pack("<2i", _MAGIC, _VERSION)
    for name, kind, value in attributes:
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    line_bytes = 4 * width * len(names)
    first = len(head) + 8 * height
    places = np.arange(height, dtype="<u8") * (8 + line_bytes) + first
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        file.write(head)
        file.write(places.astype("<u8").tobytes())
        for y, line in enumerate(lines):
            file.write(struct.pack("<2i", y, line_bytes))
            file.write(line.tobytes())
