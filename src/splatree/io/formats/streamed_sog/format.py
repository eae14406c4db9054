"""Streamed SOG (PlayCanvas): ``lod-meta.json`` and one SOG folder for each unit of a level. Reads any one level;
`splatree.lod.link` makes a tree of all.

The manifest holds a binary tree of boxes; each leaf names, for each level, a range of rows of one of ``filenames``. A level
is all of its ranges in the order of the tree, so its rows lie close together in space; level 0 is the finest. An
``environment`` (far surroundings without levels) belongs to every level and comes last. docs/reference/formats/streamed_sog.md.
"""

import json
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, get_args

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.budget import RowBudget
from splatree.io.check import checked_rows
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks, Counts, counted_chunks
from splatree.io.formats.sog import reader as sog
from splatree.io.options import ReadOptions
from splatree.io.rows import FileRows, columns_to_fill, scene_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene

MANIFEST = "lod-meta.json"
"""Name of the manifest."""
_LEVELS_MAX = 64
_DEPTH_MAX = 200
"""A box halved this often is smaller than an atom."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether the path is a folder with lod-meta.json, or that file."""
    if path.is_dir():
        return (path / MANIFEST).is_file()
    return path.name == MANIFEST


def files(path: Path) -> list[Path]:
    """The manifest, and the files of all units, of every level."""
    manifest = path / MANIFEST if path.is_dir() else path
    meta = untrusted.as_object(untrusted.read_json(manifest), str(manifest))
    units = [manifest.parent / name for name in _file_names(meta, str(manifest))]
    if meta.get("environment") is not None:
        units.append(manifest.parent / _environment(meta, str(manifest)))
    return [manifest, *(file for unit in units if unit.exists() for file in sog.files(unit))]


def read(path: Path, options: ReadOptions) -> Scene:
    """Read one level: all ranges of all units."""
    return scene_of(read_chunks(path, options), f"read {path.name}")


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """One level in chunks: a unit is decoded when its first range comes, and let go of behind its last one."""
    manifest = path / MANIFEST if path.is_dir() else path
    where = str(manifest)
    meta = untrusted.as_object(untrusted.read_json(manifest), where)
    if "version" in meta:
        untrusted.integer(meta, "version", where, low=1, high=1)
    num_levels = untrusted.integer(meta, "lodLevels", where, low=1, high=_LEVELS_MAX)
    level = options.level or 0
    if not 0 <= level < num_levels:
        raise InputError(f"{where}: found level {level}, wanted 0 (finest) to {num_levels - 1}")
    names = _file_names(meta, where)
    tree = untrusted.as_object(untrusted.field(meta, "tree", where), f"{where}: tree")
    ranges = [r for r in _ranges(tree, str(level), len(names), where) if r[2] > 0]
    _check_counts(meta, level, num_levels, sum(count for _, _, count in ranges), where)

    budget, heads = RowBudget(where), dict[Path, sog.Head]()
    places = {index: _unit_of(manifest.parent / names[index]) for index in sorted({r[0] for r in ranges})}
    for index, place in places.items():
        if place not in heads:  # a unit may be named twice
            heads[place] = _head_of(manifest.parent, names[index], budget)
    spans = list[_Span]()
    for index, offset, count in ranges:
        if offset + count > heads[places[index]].num_rows:
            raise FormatError(
                f"{where}: level {level}: found rows {offset} to {offset + count} of {names[index]}, "
                f"wanted at most its {heads[places[index]].num_rows}"
            )
        spans.append(_Span(places[index], offset, offset + count))
    for one, other in pairwise(sorted(spans)):
        if one.unit == other.unit and one.end > other.begin:
            raise FormatError(
                f"{where}: level {level}: ranges of {one.unit.name} overlap; its rows would be drawn twice"
            )
    if meta.get("environment") is not None:
        name = _environment(meta, where)
        place = _unit_of(manifest.parent / name)
        heads[place] = _head_of(manifest.parent, name, budget)
        spans.append(_Span(place, 0, heads[place].num_rows))
    modes: set[Mode] = {head.mode for head in heads.values()} or {"classic"}
    if len(modes) > 1:
        raise FormatError(f"{where}: found units trained in different modes {sorted(modes)}, wanted one")
    metadata = {
        "level": str(level),
        "level_counts": json.dumps([_num_rows(tree, i, len(names), where) for i in range(num_levels)]),
        "units": json.dumps([names[i] for i in places]),
    }
    degree = max((head.sh_degree for head in heads.values()), default=0)

    def parts() -> Iterator[tuple[Gaussians, Counts]]:
        first = 0
        for gaussians in _gone_through(spans, options):
            yield checked_rows(gaussians.with_sh_degree(degree), where, repair=options.repair, first_row=first)
            first += len(gaussians)

    num_rows = sum(span.end - span.begin for span in spans)
    return counted_chunks(parts, num_rows, degree, modes.pop(), metadata, drops_rows=bool(options.repair))


def mode_of_levels(path: Path) -> Mode | None:
    """The mode that the levels were made for, as a stream of this library says it; None: the manifest does not say."""
    value: Any = untrusted.read_json(path / MANIFEST if path.is_dir() else path)
    for key in ("asset", "splatree", "tree", "mode"):
        value = value.get(key) if isinstance(value, dict) else None
    return next((mode for mode in get_args(Mode) if mode == value), None)


class _Span(NamedTuple):
    """Rows of a unit that follow each other in a level."""

    unit: Path
    begin: int
    end: int


def _gone_through(spans: Sequence[_Span], options: ReadOptions) -> Iterator[Gaussians]:
    """The rows of all spans, a chunk at a time."""
    last = {span.unit: number for number, span in enumerate(spans)}
    units = dict[Path, FileRows]()
    for number, (unit, first, end) in enumerate(spans):
        if unit not in units:
            units[unit] = sog.open_rows(unit, options)
        rows = units[unit]
        with rows.open() as fill:
            for begin in range(first, end, ROWS_PER_CHUNK):
                part = columns_to_fill(min(ROWS_PER_CHUNK, end - begin), rows.sh_degree)
                fill(begin, part)
                yield part
        if last[unit] == number:
            del units[unit], rows, fill


def _file_names(meta: dict[str, Any], where: str) -> list[str]:
    return [
        untrusted.inner_path(untrusted.as_text(name, f"{where}: filenames"), f"{where}: filenames")
        for name in untrusted.as_list(untrusted.field(meta, "filenames", where), f"{where}: filenames")
    ]


def _environment(meta: dict[str, Any], where: str) -> str:
    return untrusted.inner_path(untrusted.text(meta, "environment", where), f"{where}: environment")


def _unit_of(path: Path) -> Path:
    """The file or folder that a name means, whichever of its names that is."""
    real = path.resolve()
    return real.parent if real.name == "meta.json" else real


def _head_of(folder: Path, name: str, budget: RowBudget) -> sog.Head:
    path = folder / name
    if not path.exists():
        raise FormatError(f"{path}: not found, but lod-meta.json names it; fetch the whole folder")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FormatError(f"{path}: leads out of its folder, to {path.resolve()}; wanted a unit inside it")
    if not (path.is_dir() or path.is_file()):
        raise FormatError(f"{path}: is neither a folder nor a plain file, but lod-meta.json names it")
    for file in sog.files(path):
        budget.add_file(file)
    head = sog.read_head(path)
    budget.take(head.num_rows)
    return head


def _ranges(root: dict[str, Any], level: str, num_files: int, where: str) -> Iterator[tuple[int, int, int]]:
    """File, offset and count of each leaf that has rows at the level, in depth-first order."""
    stack: list[tuple[Any, int]] = [(root, 0)]
    while stack:
        value, depth = stack.pop()
        node = untrusted.as_object(value, f"{where}: a node of the tree")
        if depth > _DEPTH_MAX:
            raise FormatError(f"{where}: found a tree of more than {_DEPTH_MAX} levels")
        if node.get("children") is not None:
            children = untrusted.as_list(node["children"], f"{where}: children of a node")
            stack.extend((child, depth + 1) for child in reversed(children))
        lods = untrusted.as_object(node.get("lods", {}), f"{where}: lods of a node")
        if level in lods:
            entry = untrusted.as_object(lods[level], f"{where}: lods.{level}")
            yield (
                untrusted.integer(entry, "file", f"{where}: lods.{level}", high=num_files - 1),
                untrusted.integer(entry, "offset", f"{where}: lods.{level}"),
                untrusted.integer(entry, "count", f"{where}: lods.{level}"),
            )


def _num_rows(root: dict[str, Any], level: int, num_files: int, where: str) -> int:
    return sum(count for _, _, count in _ranges(root, str(level), num_files, where))


def _check_counts(meta: dict[str, Any], level: int, num_levels: int, found: int, where: str) -> None:
    """Manifests of version 1 also say how many rows each level has."""
    if meta.get("counts") is None:
        return
    counts = untrusted.as_list(meta["counts"], f"{where}: counts")
    if len(counts) != num_levels:
        raise FormatError(f"{where}: found {len(counts)} counts, wanted one for each of {num_levels} levels")
    wanted = untrusted.as_integer(counts[level], f"{where}: counts[{level}]")
    if found != wanted:
        raise FormatError(
            f"{where}: level {level}: found ranges of {found} rows in its tree, wanted {wanted} by its counts"
        )
