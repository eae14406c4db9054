"""3D Tiles (OGC 1.1): ``tileset.json`` and a glTF with Gaussians for each tile. Reads the finest tiles; a check reads all.

A tileset is a tree of tiles. A tile has contents, children, a 4 × 4 matrix (column by column) to its parent, and refines by
REPLACE (its children stand in its place) or ADD (they come beside it). A content may be another tileset. Tiles have z up; a glTF
in them has y up and is turned first. Our scenes have y down: world z becomes −y.

A matrix of the root that puts the scene on the globe (an ellipsoid of 6,378 km) is left out, because the scene would stand
aslant there, thousands of kilometres from zero; the metadata keeps it (``globe_transform``) and a note says so.
"""

import json
import math
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.budget import RowBudget
from splatree.io.check import add_counts
from splatree.io.chunks import Chunks, Counts
from splatree.io.formats.glb import reader as gltf
from splatree.io.options import ReadOptions
from splatree.io.placing import STRETCHED, Piece, Place, placed_chunks, stretches
from splatree.io.rows import scene_of
from splatree.maths.axes import signs_between
from splatree.progress import track
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.origin import NO_ORIGIN, Origin
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64

__all__ = ["AllTiles", "check_all", "files", "read", "read_chunks", "sniff"]

_NAME = "tileset.json"
_TILES_MAX = 1 << 20
_DEPTH_MAX = 200
"""Tiles above a tile: one halved so often is smaller than an atom."""

_GLOBE_M = 6.0e6
"""A root whose matrix moves further than this stands on the globe."""

_ROWS_PER_BYTE = 0.25
"""As of a single glTF."""

_Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_SIGNS = np.diag([*signs_between("LUF", "RDF").astype(np.float64), 1.0])
"""From the axes of glTF to those of our scenes, and back."""


@dataclass(frozen=True, eq=False)
class _Content:
    path: Path
    where: str
    matrix: Float64[Array, "4 4"]  # to the tileset, z up


@dataclass
class _Found:
    """What the walk over the tiles has met."""

    contents: list[_Content] = field(default_factory=list)
    tilesets: list[Path] = field(default_factory=list)
    others: dict[str, int] = field(default_factory=dict)  # contents of other kinds, by suffix
    num_tiles: int = 0
    takes_all: bool = False  # also contents that finer tiles stand for, and files that are not there
    coarse: list[_Content] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)  # what is wrong with files that are not there


def sniff(path: Path, head: bytes) -> bool:
    """Whether the path is a folder with tileset.json, or that file."""
    if path.is_dir():
        return (path / _NAME).is_file()
    return path.name == _NAME and head.lstrip()[:1] == b"{"


def files(path: Path) -> list[Path]:
    """The tilesets and the contents of all finest tiles, with their buffers."""
    found, _ = _walk(path / _NAME if path.is_dir() else path)
    contents = dict.fromkeys(content.path for content in found.contents)
    return [*found.tilesets, *dict.fromkeys(file for content in contents for file in gltf.files(content))]


def read(path: Path, options: ReadOptions) -> Scene:
    """Read the finest tiles as one scene."""
    return scene_of(read_chunks(path, options), f"read {path.name}")


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """The finest tiles as one scene in chunks, one file after the other."""
    manifest = path / _NAME if path.is_dir() else path
    where = str(manifest)
    found, globe = _walk(manifest)
    budget, pieces, modes, lost = RowBudget(where, _ROWS_PER_BYTE), list[Piece](), set[Mode](), list[str]()
    for content in found.contents:
        chunks = gltf.read_chunks(content.path, options)
        for file in gltf.files(content.path):
            budget.add_file(file)
        budget.take(len(chunks))
        pieces.append(_piece(content, chunks))
        modes.add(chunks.mode)
        lost += json.loads(chunks.metadata.get("lost", "[]"))
        if stretches(content.matrix) and chunks.sh_degree > 0:
            lost.append(STRETCHED)
    _check_contents(found, modes, where)
    if found.others:
        lost.append(f"tiles of other kinds: {_others(found)}")
    metadata = {"tiles": str(len(pieces))}
    if lost:
        metadata["lost"] = json.dumps(list(dict.fromkeys(lost)))
    if globe is not None:
        metadata["globe_transform"] = json.dumps(globe.T.ravel().tolist())
        metadata["notes"] = json.dumps(
            ["the matrix that puts the tileset on the globe is left out: coordinates are those of its root tile"]
        )
    return placed_chunks(lambda: nullcontext(pieces), where, modes.pop(), metadata, repair=options.repair)


@dataclass(frozen=True)
class AllTiles:
    """What all tiles of a tileset hold."""

    num_gaussians: int
    """Gaussians of the finest tiles."""
    num_rows: int
    """Gaussians of all tiles."""
    num_bytes: int
    """Bytes of the tilesets and of the files of all tiles."""


def check_all(path: Path, options: ReadOptions) -> AllTiles:
    """Read every tile, those that finer ones stand for too, one file after the other.

    Raises:
        FormatError: names each file that is damaged or missing; or there are no tiles, or they are drawn in different modes.
    """
    manifest = path / _NAME if path.is_dir() else path
    found, _ = _walk(manifest, takes_all=True)
    counts, modes = dict[Path, int](), set[Mode]()
    for content in track([*found.contents, *found.coarse], f"check {path.name}"):
        try:
            if content.path not in counts:
                chunks = gltf.read_chunks(content.path, options)
                counts[content.path] = sum(map(len, chunks))
                modes.add(chunks.mode)
            _place(content, NO_ORIGIN)
        except InputError as error:
            found.damaged.append(str(error))
        except OSError as error:
            found.damaged.append(f"{content.path}: cannot be read ({error.strerror or error})")
    damaged = list(dict.fromkeys(found.damaged))
    if damaged:
        raise FormatError(
            f"{manifest}: found {len(damaged)} of its tiles damaged or missing, wanted all whole; make the stream again:\n"
            + "\n".join(damaged)
        )
    _check_contents(found, modes, str(manifest))
    finest, coarse = (sum(counts[content.path] for content in each) for each in (found.contents, found.coarse))
    stored = dict.fromkeys(file for path in counts for file in gltf.files(path))
    return AllTiles(finest, finest + coarse, sum(file.stat().st_size for file in (*found.tilesets, *stored)))


def _check_contents(found: _Found, modes: set[Mode], where: str) -> None:
    if not found.contents:
        words = _others(found) or "no contents"
        raise FormatError(f"{where}: found no glTF in its tiles ({words}), wanted Gaussians in .glb or .gltf")
    if len(modes) > 1:
        raise FormatError(f"{where}: found tiles drawn in different modes, wanted one")


def _piece(content: _Content, chunks: Chunks) -> Piece:
    """The Gaussians of a tile and where the tileset puts them."""

    def make() -> Iterator[tuple[Gaussians, Counts]]:
        for chunk in chunks:
            yield chunk, {}
        yield Gaussians.empty(chunks.sh_degree), add_counts(chunks.metadata.get("repairs"), chunks.repairs)

    return Piece(len(chunks), chunks.sh_degree, make, _place(content, chunks.origin))


def _place(content: _Content, origin: Origin) -> Place | None:
    y_up = np.linalg.inv(_Z_UP_FROM_Y_UP) @ content.matrix @ _Z_UP_FROM_Y_UP
    return Place.of(_SIGNS @ y_up @ _SIGNS, content.where, origin=origin)


def _others(found: _Found) -> str:
    return ", ".join(f"{count} {suffix}" for suffix, count in found.others.items())


def _walk(manifest: Path, *, takes_all: bool = False) -> tuple[_Found, Float64[Array, "4 4"] | None]:
    """The finest contents, or all of them, and the matrix of the root if it stands on the globe."""
    found = _Found(takes_all=takes_all)
    root = _root(manifest, found)
    where = f"{manifest}: root"
    matrix = _matrix(root, where)
    globe = matrix if float(np.linalg.norm(matrix[:3, 3])) > _GLOBE_M else None
    waiting = [
        _Tile(root, manifest, np.eye(4) if globe is not None else matrix, where, 0, frozenset({manifest.resolve()}))
    ]
    while waiting:
        tile = waiting.pop()
        waiting += reversed(list(_visit(tile, found, manifest.parent)))
    return found, globe


@dataclass(frozen=True, eq=False)
class _Tile:
    record: dict[str, Any]
    manifest: Path
    matrix: Float64[Array, "4 4"]
    where: str
    depth: int
    above: frozenset[Path]  # the tilesets that it stands in


def _visit(tile: _Tile, found: _Found, folder: Path) -> Iterator[_Tile]:
    """Note the contents of a tile that are drawn at the finest level; yield its children."""
    found.num_tiles += 1
    if found.num_tiles > _TILES_MAX or tile.depth > _DEPTH_MAX:
        raise FormatError(f"{tile.where}: found more than {_TILES_MAX} tiles, or {_DEPTH_MAX} within each other")
    record = tile.record
    if "implicitTiling" in record:
        raise FormatError(f"{tile.where}: found implicitTiling, wanted tiles that are written out")
    children = untrusted.as_list(record.get("children") or [], f"{tile.where}.children")
    is_replaced = bool(children) and str(record.get("refine", "REPLACE")).upper() != "ADD"
    for i, content in enumerate(_contents(record, tile.where)):
        where = f"{tile.where}.content[{i}]"
        uri = untrusted.text(content, "uri" if "uri" in content else "url", where)
        suffix = Path(uri.split("?")[0]).suffix.lower()
        if suffix == ".json":
            path = untrusted.inner_file(folder, _inside(tile.manifest.parent, uri, folder, where), where)
            if path.resolve() in tile.above:
                raise FormatError(f"{where}: found {uri!r}, a tileset within itself")
            inner = _root(path, found)
            matrix = tile.matrix @ _matrix(inner, f"{path}: root")
            yield _Tile(inner, path, matrix, f"{path}: root", tile.depth + 1, tile.above | {path.resolve()})
        elif is_replaced and not found.takes_all:
            continue
        elif suffix in (".glb", ".gltf"):
            try:
                path = untrusted.inner_file(folder, _inside(tile.manifest.parent, uri, folder, where), where)
            except FormatError as error:
                if not found.takes_all:
                    raise
                found.damaged.append(str(error))
                continue
            (found.coarse if is_replaced else found.contents).append(_Content(path, where, tile.matrix))
        else:
            found.others[suffix] = found.others.get(suffix, 0) + 1
    for i, child in enumerate(children):
        where = f"{tile.where}.children[{i}]"
        inner = untrusted.as_object(child, where)
        inner = {"refine": record.get("refine", "REPLACE"), **inner}
        yield _Tile(inner, tile.manifest, tile.matrix @ _matrix(inner, where), where, tile.depth + 1, tile.above)


def _root(manifest: Path, found: _Found) -> dict[str, Any]:
    found.tilesets.append(manifest)
    content = untrusted.as_object(untrusted.read_json(manifest), str(manifest))
    return untrusted.as_object(untrusted.field(content, "root", str(manifest)), f"{manifest}: root")


def _contents(record: dict[str, Any], where: str) -> Iterator[dict[str, Any]]:
    if record.get("content") is not None:
        yield untrusted.as_object(record["content"], f"{where}.content")
    for value in untrusted.as_list(record.get("contents") or [], f"{where}.contents"):
        yield untrusted.as_object(value, f"{where}.contents")


def _inside(base: Path, uri: str, folder: Path, where: str) -> str:
    """A URI of a tileset in a folder below as a path of the outermost folder."""
    from urllib.parse import unquote

    name = unquote(uri.split("?")[0].split("#")[0])
    inner = base / name.replace("\\", "/")
    try:
        return inner.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return untrusted.inner_path(name, where)


def _matrix(record: dict[str, Any], where: str) -> Float64[Array, "4 4"]:
    """The matrix of a tile to its parent."""
    if record.get("transform") is None:
        return np.eye(4)
    matrix: Array = untrusted.numbers(record, "transform", where, (16,)).reshape(4, 4).T
    if not math.isclose(float(matrix[3, 3]), 1.0) or bool(matrix[3, :3].any()):
        raise FormatError(f"{where}.transform: found the last row {matrix[3].tolist()}, wanted 0 0 0 1")
    return matrix
