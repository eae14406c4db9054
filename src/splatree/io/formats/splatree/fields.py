"""The fields of a scene as columns and strings, by their dotted names, and back.

Which there are follows from the fields of `Scene` and of the structs in it. Arrays are columns, everything else is JSON.
"""

import json
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.scene.levels import LevelRecord
from splatree.scene.origin import NO_ORIGIN
from splatree.scene.scene import Source
from splatree.shapes import Array

__all__ = [
    "NOT_STORED",
    "PAGES",
    "STORED_AS",
    "cluster_types",
    "column_types",
    "columns_of",
    "source_from",
    "source_text",
    "struct_from",
    "value_of",
    "values_of",
]

PAGES = "pages"
"""The column of the index of pages (io/pages/index_file.py), which is of the file and not of the scene."""

NOT_STORED = ("blocks",)
"""Fields of a scene that are of this run: an index that is made anew."""

_WORLD_ORIGIN = "world_origin"
"""Key of `Source.origin` among the provenance; left out where it is zero."""

STORED_AS = {"tile_rule": "extent"}
"""Fields whose name in the file is an older one, which stays so that files of every version are read by every version."""


def columns_of(struct: Any, prefix: str) -> Iterator[tuple[str, Array]]:
    """Each array of a struct and of the structs in it, by its dotted name."""
    for f in fields(struct):
        value = getattr(struct, f.name)
        if isinstance(value, np.ndarray):
            yield prefix + f.name, value
        elif is_dataclass(value) and not isinstance(value, Source | LevelRecord):
            yield from columns_of(value, f"{prefix}{f.name}.")


def values_of(struct: Any, prefix: str) -> Iterator[tuple[str, str]]:
    """Each field that is neither an array nor a struct, by its dotted name, as JSON."""
    for f in fields(struct):
        value = getattr(struct, f.name)
        if isinstance(value, Source):
            yield prefix + f.name, source_text(value)
        elif isinstance(value, LevelRecord):
            yield prefix + f.name, value.to_json()
        elif is_dataclass(value):
            yield from values_of(value, f"{prefix}{f.name}.")
        elif value is not None and not isinstance(value, np.ndarray):
            yield prefix + STORED_AS.get(f.name, f.name), json.dumps(value)


def column_types(
    n: int, k: int, *, has_ids: bool, has_curves: bool
) -> dict[str, tuple[np.dtype[Any], tuple[int, ...]]]:
    """Type and shape of the columns of every scene, by their names: ``n`` rows with ``k`` coefficients of harmonics."""
    floats, ids = np.dtype("<f4"), {"ids": (np.dtype("<u4"), (n,))} if has_ids else {}
    curves: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {"tree.curves": (floats, (n, 4))} if has_curves else {}
    return {
        "gaussians.means": (floats, (n, 3)),
        "gaussians.quats": (floats, (n, 4)),
        "gaussians.log_scales": (floats, (n, 3)),
        "gaussians.logit_opacities": (floats, (n,)),
        "gaussians.sh": (floats, (n, k, 3)),
        "tree.subtree_end": (np.dtype("<i4"), (n,)),
        "tree.depth": (np.dtype("u1"), (n,)),
        "tree.extents": (floats, (n,)),
        **curves,
        **ids,
    }


def cluster_types(c: int) -> dict[str, tuple[np.dtype[Any], tuple[int, ...]]]:
    """Type and shape of the columns of ``c`` clusters, by their names."""
    floats = np.dtype("<f4")
    return {
        "clusters.start": (np.dtype("<i4"), (c + 1,)),
        "clusters.centers": (floats, (c, 3)),
        **{f"clusters.{name}": (floats, (c,)) for name in ("radii", "mean_radii", "footprint_radii")},
        **{f"clusters.{name}": (floats, (c, 3)) for name in ("box_low", "box_high")},
    }


def source_text(source: Source) -> str:
    """The provenance as JSON, and where the first file came from, without this machine's folders."""
    metadata = dict(source.metadata)
    if source.format and source.format != "splatree":
        metadata["origin"] = json.dumps({"format": source.format, "names": [Path(p).name for p in source.paths]})
    if source.origin != NO_ORIGIN:
        metadata[_WORLD_ORIGIN] = json.dumps(source.origin)
    return json.dumps(metadata)


def struct_from(kind: type, prefix: str, columns: dict[str, Array], values: Mapping[str, Any], where: str) -> Any:
    """A struct from the columns and values under a prefix; takes what it uses out of ``columns``."""
    arguments: dict[str, Any] = {}
    for name, hint in _hints_of(kind).items():
        key = prefix + STORED_AS.get(name, name)
        if key in NOT_STORED:
            continue
        inner, optional = _unwrap(hint)
        if inner is Source:
            arguments[name] = source_from(values, key, where)
        elif inner is LevelRecord:
            text = values.get(key)
            arguments[name] = (
                None if text is None else LevelRecord.from_json(untrusted.as_text(text, f"{where}: {key}"))
            )
        elif isinstance(inner, type) and is_dataclass(inner):
            held = any(k.startswith(f"{key}.") for k in columns)
            arguments[name] = struct_from(inner, f"{key}.", columns, values, where) if held or not optional else None
        elif get_origin(inner) is Annotated:
            if key not in columns and not optional:
                raise FormatError(
                    f"{where}: found no column {key!r}; the file is damaged or was made by another version"
                )
            arguments[name] = columns.pop(key, None)
        else:
            arguments[name] = None if optional and key not in values else value_of(values, key, where)
    try:
        return kind(**arguments)
    except TypeError as error:  # a number where a string is wanted, or the like
        raise FormatError(f"{where}: {prefix or 'scene'}: {error}") from error


@cache
def _hints_of(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def source_from(values: Mapping[str, Any], key: str, where: str) -> Source:
    """The provenance that `source_text` wrote."""
    metadata = untrusted.as_object(value_of(values, key, where), f"{where}: {key}")
    texts = {k: untrusted.as_text(v, f"{where}: {key}.{k}") for k, v in metadata.items()}
    origin = NO_ORIGIN
    if _WORLD_ORIGIN in texts:
        parsed = {_WORLD_ORIGIN: untrusted.parse_json(texts.pop(_WORLD_ORIGIN).encode(), f"{where}: {key}")}
        x, y, z = untrusted.numbers(parsed, _WORLD_ORIGIN, f"{where}: {key}", (3,)).tolist()
        origin = x, y, z
    return Source(metadata=texts, origin=origin)


def _unwrap(hint: Any) -> tuple[Any, bool]:
    """The type without "| None", and whether None was allowed."""
    if get_origin(hint) in (Union, types.UnionType):
        inner = [a for a in get_args(hint) if a is not type(None)]
        return inner[0], len(inner) < len(get_args(hint))
    return hint, False


def value_of(values: Mapping[str, Any], key: str, where: str) -> Any:
    """The value of a string of the header that holds JSON."""
    text = untrusted.text(values, key, f"{where}: __metadata__")
    return untrusted.parse_json(text.encode(), f"{where}: __metadata__.{key}")
