"""The protocol between page and server.

The page sends JSON texts, which are not trusted: a number that is missing, not finite or out of its range is an error that
closes the connection. The server sends binary messages, little-endian:

::

    u32 length of the JSON, JSON padded with blanks to a multiple of 4 with the length, payload

``kind`` in the JSON is `scene` (facts of the scene; forget all nodes), `cut` (a `Change`), `frame` (a picture as a file),
`point` (where a pixel's ray ends), `boxes` (float32 "b 2 3"), `look` (a camera to take) or `error`. The page answers each
`cut` and `frame` with ``ack``: the server never has more than two of them under way, so a page that stops reading holds up its
own worker only.
"""

import json
import struct
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from splatree.errors import InputError
from splatree.scene.cameras import Camera
from splatree.scene.options import SelectOptions
from splatree.shapes import Array, Float64
from splatree.view.boxes import BoxKind
from splatree.view.options import CAPACITY, LEAST_QUALITY_DB, MOST_QUALITY_DB
from splatree.view.pictures import Layer, Packing

__all__ = ["Ack", "Request", "Want", "pack_message", "parse"]

Want = Literal["cut", "frame", "point", "boxes"]
"""What a page asks for."""

TEXT_BYTES = 65_536
"""Longest text that is taken."""

PIXELS_MAX = 16_000_000
"""Largest picture, px."""


@dataclass(frozen=True)
class Ack:
    """The page has taken so many messages in since it connected."""

    count: int
    """Messages of the kinds `cut` and `frame`."""


@dataclass(frozen=True, eq=False)
class Request:
    """A view that a page wants."""

    want: Want
    """What of it."""
    seq: int
    """Number that the answer repeats."""
    camera: Camera
    """The view, in world coordinates."""
    select: SelectOptions
    """τ_R or quality, and budget."""
    guard: float = 0.0
    """Share of the picture that is added on each side of a cut, for a camera that moves on."""
    layer: Layer = "color"
    """What a picture shows."""
    packing: Packing = "jpeg"
    """How a picture is sent."""
    is_moving: bool = False
    """Whether the camera moves: a picture that is made fast will do."""
    quality: int = 80
    """Quality of a JPEG, 1 to 100."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Colour behind everything, RGB 0 to 1."""
    is_held: bool = False
    """Whether a picture is of the cut that the page holds, whatever chose it; else ``select`` chooses."""
    box: Float64[Array, "2 3"] | None = None
    """Corners of a box in world coordinates, outside of which nothing is drawn."""
    at: tuple[float, float] = (0.0, 0.0)
    """Pixel whose point is wanted."""
    boxes: BoxKind = "blocks"
    """Which boxes are wanted."""


def parse(text: str, centre: Float64[Array, "3"]) -> Request | Ack:
    """A text of the page; its coordinates are relative to ``centre``.

    Raises:
        InputError: it is not what a page sends.
    """
    if len(text) > TEXT_BYTES:
        raise InputError(f"message: found {len(text):,} characters, wanted at most {TEXT_BYTES:,}")
    try:
        record = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("message: found no JSON, wanted an object") from error
    if not isinstance(record, dict):
        raise InputError("message: found other JSON, wanted an object")
    if "ack" in record:
        return Ack(int(_number(record, "ack", 0, 2**53)))
    want = _name(record, "want", Want, "cut")
    box = None
    if record.get("box") is not None:
        box = np.array(_numbers(record, "box", 6, 1e12)).reshape(2, 3) + centre
    red, green, blue = _numbers(record, "background", 3, 1.0) if "background" in record else (0.0, 0.0, 0.0)
    x, y = _numbers(record, "at", 2, 1e5) if "at" in record else (0.0, 0.0)
    return Request(
        want=want,
        seq=int(_number(record, "seq", 0, 2**53)),
        camera=_camera(record, centre),
        select=_select(record),
        guard=_number(record, "guard", 0, 0.5, 0.0),
        layer=_name(record, "layer", Layer, "color"),
        packing=_name(record, "packing", Packing, "jpeg"),
        is_moving=_flag(record, "moving"),
        is_held=_flag(record, "held"),
        quality=int(_number(record, "quality", 1, 100, 80)),
        background=(max(red, 0.0), max(green, 0.0), max(blue, 0.0)),
        box=box,
        at=(x, y),
        boxes=_name(record, "boxes", BoxKind, "blocks"),
    )


def _select(record: dict[str, Any]) -> SelectOptions:
    """A quality, where one is wanted, goes before τ_R."""
    pixel_error, budget = _number(record, "tau", 0, 1e4), int(_number(record, "budget", 1_000, CAPACITY))
    occlusion = _flag(record, "occlusion")
    if record.get("db") is None:
        return SelectOptions(pixel_error, budget, occlusion=occlusion)
    quality = _number(record, "db", LEAST_QUALITY_DB, MOST_QUALITY_DB)
    return SelectOptions(budget=budget, quality=quality, occlusion=occlusion)


def pack_message(header: dict[str, Any], payload: bytes = b"") -> bytes:
    """One binary message."""
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 4)
    return struct.pack("<I", len(text)) + text + payload


def _camera(record: dict[str, Any], centre: Array) -> Camera:
    width, height = int(_number(record, "w", 1, 32_768)), int(_number(record, "h", 1, 32_768))
    if width * height > PIXELS_MAX:
        raise InputError(f"message: found a picture of {width} × {height} px, wanted at most {PIXELS_MAX:,} px")
    pose = np.array(_numbers(record, "c2w", 12, 1e12)).reshape(3, 4)
    focal = _number(record, "f", 1e-3, 1e7)
    rotation = pose[:, :3].T
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = rotation
    camera_from_world[:3, 3] = -rotation @ (pose[:, 3] + centre)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(camera_from_world, K, width, height, near=_number(record, "near", 1e-9, 1e9, 0.2))


def _number(record: dict[str, Any], key: str, low: float, high: float, default: float | None = None) -> float:
    value = record.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(f"message: {key}: found {str(value)[:40]!r}, wanted a number from {low:g} to {high:g}")
    return float(value)


def _flag(record: dict[str, Any], key: str) -> bool:
    value = record.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"message: {key}: found {str(value)[:40]!r}, wanted true or false")
    return value


def _numbers(record: dict[str, Any], key: str, count: int, largest: float) -> list[float]:
    values = record.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise InputError(f"message: {key}: wanted {count} numbers")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not -largest <= value <= largest:
            raise InputError(f"message: {key}: found {str(value)[:40]!r}, wanted numbers of at most {largest:g}")
    return [float(value) for value in values]


def _name(record: dict[str, Any], key: str, kind: Any, default: str) -> Any:
    value = record.get(key, default)
    if value not in get_args(kind):
        raise InputError(f"message: {key}: found {str(value)[:40]!r}, wanted one of {', '.join(get_args(kind))}")
    return value
