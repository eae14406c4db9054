"""Typed access to JSON from outside: every error names the file, the key, what was found and what was wanted."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError
from splatree.io.foreign import not_content
from splatree.shapes import Array

MAX_JSON_BYTES = 1 << 28
"""A larger JSON file (a camera takes about 500 bytes, a node of a streamed scene 400) is refused unread."""


def read_json(path: Path) -> Any:
    """Parse a JSON file."""
    size = path.stat().st_size
    if size > MAX_JSON_BYTES:
        raise FormatError(f"{path}: found {size} bytes of JSON, wanted at most {MAX_JSON_BYTES}")
    return parse_json(path.read_bytes(), str(path))


def parse_json(data: bytes, where: str) -> Any:
    """Parse JSON; ``where`` names the file in errors."""
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        if content := not_content(data[:4096]):
            raise FormatError(f"{where}: {content}") from error
        raise FormatError(f"{where}: not valid JSON ({error}); the file is damaged or of another kind") from error


def as_object(value: Any, where: str) -> dict[str, Any]:
    """The value if it is a JSON object."""
    if not isinstance(value, dict):
        raise FormatError(f"{where}: found {_kind(value)}, wanted an object {{…}}")
    return value


def as_list(value: Any, where: str) -> list[Any]:
    """The value if it is a JSON list."""
    if not isinstance(value, list):
        raise FormatError(f"{where}: found {_kind(value)}, wanted a list […]")
    return value


def field(record: Mapping[str, Any], key: str, where: str) -> Any:
    """The value of a key that must be there."""
    if key not in record:
        raise FormatError(f"{where}: found no key {key!r}, only {sorted(record)[:12]}")
    return record[key]


def integer(record: Mapping[str, Any], key: str, where: str, *, low: int = 0, high: int = 2**31 - 1) -> int:
    """A whole number from ``low`` to ``high``."""
    return as_integer(field(record, key, where), f"{where}.{key}", low=low, high=high)


def as_integer(value: Any, where: str, *, low: int = 0, high: int = 2**31 - 1) -> int:
    """The value if it is a whole number from ``low`` to ``high``."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise FormatError(f"{where}: found {_short(value)}, wanted a whole number from {low} to {high}")
    return value


def number(record: Mapping[str, Any], key: str, where: str) -> float:
    """A finite number."""
    return float(numbers(record, key, where, ()))


def numbers(record: Mapping[str, Any], key: str, where: str, shape: tuple[int, ...]) -> Array:
    """Finite numbers, nested lists of the given shape, as float64."""
    value = field(record, key, where)
    try:
        array = np.asarray(value, np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise FormatError(f"{where}.{key}: found {_kind(value)} that does not hold numbers only") from error
    if array.shape != shape:
        raise FormatError(f"{where}.{key}: found numbers of shape {array.shape}, wanted {shape}")
    if not np.isfinite(array).all():
        raise FormatError(f"{where}.{key}: found NaN or infinity, wanted finite numbers")
    return array


def text(record: Mapping[str, Any], key: str, where: str) -> str:
    """A string."""
    return as_text(field(record, key, where), f"{where}.{key}")


def as_text(value: Any, where: str) -> str:
    """The value if it is a string."""
    if not isinstance(value, str):
        raise FormatError(f"{where}: found {_kind(value)}, wanted a string")
    return value


def inner_path(name: str, where: str) -> str:
    """The name if it is a relative path that stays inside its folder."""
    parts = name.replace("\\", "/").split("/")
    if not name or "\0" in name or ":" in name or any(part in ("", "..") for part in parts):
        raise FormatError(f"{where}: found the file name {name!r}, wanted a relative path inside the folder")
    return "/".join(parts)


def inner_file(folder: Path, name: str, where: str) -> Path:
    """The file of a folder that an untrusted name names: a plain file that lies in the folder, wherever links lead.

    Raises:
        FormatError: the name or a link leads out of the folder, or there is no plain file.
    """
    path = folder / inner_path(name, where)
    try:
        real = path.resolve(strict=True)
    except (OSError, RuntimeError) as error:  # not there, or a loop of links
        raise FormatError(
            f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}), but {where} names it"
        ) from error
    if not real.is_relative_to(folder.resolve()):
        raise FormatError(f"{path}: leads out of its folder, to {real}; wanted a file inside it")
    if not real.is_file():
        raise FormatError(f"{path}: is no plain file (a folder, device or pipe), but {where} names it")
    return path


def _kind(value: Any) -> str:
    kinds = {dict: "an object", list: "a list", str: "a string", bool: "a boolean", type(None): "null"}
    return kinds.get(type(value), "a number")


def _short(value: Any) -> str:
    shown = repr(value) if isinstance(value, int | float | str) else _kind(value)
    return shown if len(shown) <= 80 else shown[:77] + "..."
