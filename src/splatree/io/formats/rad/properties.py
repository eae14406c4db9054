"""Encodings of the properties in a chunk of a ``.rad`` file: n rows of d values as bytes.

Values are planar: all rows' first value, then all rows' second, and so on. ``*_lebytes`` takes the planes apart once more, the
lowest bytes of all values first; ``*_delta`` stores the difference to the row before, modulo 256.

=====================  ====================================================================================
encoding               value
=====================  ====================================================================================
f32, f16               itself; ``ln_f16``: its logarithm
r8, r8_delta           min + (max − min) u / 255
s8, s8_delta           max i / 127
ln_0r8                 0 for u = 0, else e^(min + (max − min) (u − 1) / 254)
oct88r8                a rotation in 3 bytes, row by row: the axis on an octahedron, the angle 0 to π in 255 steps
u16, u32               whole numbers
=====================  ====================================================================================

8-bit codes are looked up in a table of 256 values made in float64. Scales are decoded to their logarithms, which is what we keep.
"""

from functools import cache
from typing import Any

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.shapes import Array

WIDTHS = {
    **{"center": 3, "alpha": 1, "rgb": 3, "scales": 3, "orientation": 4},
    **{"sh1": 9, "sh2": 15, "sh3": 21, "sh1_code": 9, "sh2_code": 15, "sh3_code": 21},
    **{"sh_label": 1, "child_count": 1, "child_start": 1, "extent": 1},
}
"""Values of a row in each property."""

_FLOATS = ("f32", "f16", "f32_lebytes", "f16_lebytes")
_SIGNED = ("r8", "r8_delta", "s8", "s8_delta")
_ENCODINGS = {
    "center": _FLOATS,
    "alpha": (*_FLOATS[:2], "r8"),
    "rgb": (*_FLOATS[:2], "r8", "r8_delta"),
    "scales": ("f32", "ln_f16", "ln_0r8"),
    "orientation": (*_FLOATS[:2], "oct88r8"),
    **dict.fromkeys(("sh1", "sh2", "sh3", "sh1_code", "sh2_code", "sh3_code"), (*_FLOATS[:2], *_SIGNED)),
    "sh_label": ("u16", "u32"),
    "child_count": ("u16",),
    "child_start": ("u32",),
    "extent": ("f32",),
}
"""Encodings of each property."""

_SIZES = {"f32": 4, "f16": 2, "f32_lebytes": 4, "f16_lebytes": 2, "ln_f16": 2, "u16": 2, "u32": 4}
"""Bytes of a value; all others take one."""

HALF_MAX = 65504.0
"""The largest number of half precision."""

LOG_SCALE_ZERO = -30.0
"""Logarithm for which a scale of 0 is read, and below which it is written."""


def stored_values(name: str, encoding: str) -> int:
    """Values of a row that are stored: three of four for a rotation, whose w follows from its length or is in the angle."""
    return 3 if name == "orientation" else WIDTHS[name]


def raw_bytes(name: str, encoding: str, num_rows: int) -> int:
    """Bytes of a property before compression."""
    return num_rows * stored_values(name, encoding) * _SIZES.get(encoding, 1)


def check_encoding(name: str, encoding: str, where: str) -> None:
    """Refuse what no table says how to read."""
    if name not in _ENCODINGS:
        raise FormatError(f"{where}: found the property {name[:40]!r}, wanted one of {', '.join(_ENCODINGS)}")
    if encoding not in _ENCODINGS[name]:
        raise FormatError(f"{where}: found encoding {encoding[:40]!r}, wanted {' or '.join(_ENCODINGS[name])}")


def decode(name: str, encoding: str, data: bytes, num_rows: int, property_: dict[str, Any], where: str) -> Array:
    """Values "n d": float32 (scales as logarithms), or uint32 of labels and links."""
    width = stored_values(name, encoding)
    if encoding == "oct88r8":
        return _rotations_from_codes(np.frombuffer(data, np.uint8).reshape(num_rows, 3))
    if encoding in ("u16", "u32"):
        return np.frombuffer(data, f"<{encoding[0]}{int(encoding[1:]) // 8}").astype(np.uint32).reshape(num_rows, 1)
    if _SIZES.get(encoding, 1) > 1:
        values = _floats(encoding, data, num_rows, width)
        if name == "orientation":
            w = np.sqrt(np.maximum(0, 1 - np.einsum("ij,ij->i", values, values)))
            return np.column_stack([w, values])
        return _logarithms(values) if encoding == "f32" and name == "scales" else values
    codes = np.frombuffer(data, np.uint8).reshape(width, num_rows)
    if encoding.endswith("_delta"):
        codes = np.add.accumulate(codes, axis=1, dtype=np.uint8)
    return np.take(_table(encoding, property_, where), np.ascontiguousarray(codes.T))


def _floats(encoding: str, data: bytes, num_rows: int, width: int) -> Array:
    size = _SIZES[encoding]
    planes = np.frombuffer(data, np.uint8)
    if encoding.endswith("lebytes"):
        planes = np.ascontiguousarray(planes.reshape(size, -1).T)  # [values size]
    return np.ascontiguousarray(planes.reshape(-1).view(f"<f{size}").reshape(width, num_rows).T, np.float32)


def _logarithms(scales: Array) -> Array:
    with np.errstate(
        invalid="ignore", divide="ignore"
    ):  # a negative scale becomes NaN, which the check of values names
        return np.asarray(np.where(scales == 0, np.float32(LOG_SCALE_ZERO), np.log(scales)), np.float32)


def _table(encoding: str, property_: dict[str, Any], where: str) -> Array:
    """The value of each of 256 codes; the logarithm of scales."""
    high = untrusted.number(property_, "max", where)
    codes = np.arange(256)
    if encoding.startswith("s8"):
        table = codes.astype(np.uint8).view(np.int8) / 127 * high
    else:
        low = untrusted.number(property_, "min", where)
        if encoding == "ln_0r8":
            table = low + (high - low) * (codes - 1) / 254
            table[0] = LOG_SCALE_ZERO
        else:
            table = low + (high - low) * codes / 255
    with np.errstate(over="ignore"):  # absurd ranges give values that the check of values finds
        return table.astype(np.float32)


def _rotations_from_codes(codes: Array) -> Array:
    """wxyz of an axis (u, v) and an angle."""
    axis = np.take(_octahedral_axes(), codes[:, 0].astype(np.intp) << 8 | codes[:, 1], axis=0)
    half_angle = np.arange(256) / 255 * np.pi / 2
    quats = np.empty((len(codes), 4), np.float32)
    quats[:, 0] = np.cos(half_angle).astype(np.float32)[codes[:, 2]]
    quats[:, 1:] = axis * np.sin(half_angle).astype(np.float32)[codes[:, 2], None]
    return quats


@cache
def _octahedral_axes() -> Array:
    """Unit vectors "65536 3" of all (u, v): the octahedron |x| + |y| + |z| = 1, its lower half folded out to a square."""
    square = np.arange(256) / 255 * 2 - 1
    x, y = (np.broadcast_to(side, (256, 256)).copy() for side in (square[:, None], square[None, :]))
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    x -= np.copysign(fold, x)
    y -= np.copysign(fold, y)
    axes = np.stack([x, y, z], axis=-1).reshape(65536, 3)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return axes.astype(np.float32)


def encode_floats(values: Array, encoding: str) -> bytes:
    """Values "n d" as f32, f16 or byte planes of f32; f16 clamps to ±65504."""
    size = _SIZES[encoding]
    if size == 2:
        values = np.clip(values, -HALF_MAX, HALF_MAX)
    planes = np.ascontiguousarray(values.T, f"<f{size}")
    if encoding.endswith("lebytes"):
        planes = np.ascontiguousarray(planes.reshape(-1).view(np.uint8).reshape(-1, size).T)
    return bytes(planes.tobytes())


def encode_codes(values: Array, low: float, high: float, *, steps: int, first: int = 0, delta: bool = False) -> bytes:
    """Values "n d" as bytes ``first`` … ``first + steps`` spread from low to high; outer values are clipped."""
    scale = np.float32(steps / (high - low))
    codes = np.rint(np.clip((values - np.float32(low)) * scale, 0, steps)).astype(np.int16) + np.int16(first)
    planes = np.ascontiguousarray(codes.astype(np.uint8).T)
    if delta:
        planes[:, 1:] = np.diff(planes, axis=1)
    return planes.tobytes()


def encode_rotations(quats: Array) -> bytes:
    """Quaternions wxyz of any length as oct88r8: of the four axes of the grid around theirs, the one that comes closest.

    The best angle about an axis a is 2 atan2(v · a, w), which makes up for some of the error of the axis.
    """
    q = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    q *= np.where(q[:, :1] < 0, np.float32(-1), np.float32(1))
    sums = np.abs(q[:, 1:]).sum(axis=1)
    x, y, z = q[:, 1:].T / np.where(sums > 0, sums, 1)
    u = np.where(z < 0, np.copysign(1 - np.abs(y), x), x)
    v = np.where(z < 0, np.copysign(1 - np.abs(x), y), y)
    corner = [np.clip((side + 1) * np.float32(127.5), 0, 255).astype(np.intp) for side in (u, v)]
    best, found = np.zeros((len(q), 3), np.uint8), np.full(len(q), -1, np.float32)
    for du, dv in ((0, 0), (0, 1), (1, 0), (1, 1)):
        at = [np.minimum(side + step, 255) for side, step in zip(corner, (du, dv), strict=True)]
        along = np.einsum("ij,ij->i", np.take(_octahedral_axes(), at[0] << 8 | at[1], axis=0), q[:, 1:])
        angle = np.rint(np.clip(2 * np.arctan2(along, q[:, 0]), 0, np.pi) * np.float32(255 / np.pi))
        half_angle = angle * np.float32(np.pi / 510)
        closeness = q[:, 0] * np.cos(half_angle) + along * np.sin(half_angle)  # cosine of half the turn between them
        better = closeness > found
        found[better] = closeness[better]
        best[better] = np.column_stack([*at, angle])[better].astype(np.uint8)
    return bytes(best.tobytes())
