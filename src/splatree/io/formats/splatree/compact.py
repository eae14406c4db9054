"""A compact ``.splatree``: quantised columns. Version 2 of the file; the container is that of the exact form.

- Leaves are the pictures of a SOG, with the leaves in the order of the tree. What was read from a SOG loses nothing more but for
  the quanta of its means.
- Merged nodes are what their leaves suggest, and differences from it (`inner.py`).
- The tree is its depths, from which the ends of subtrees follow.
- Extents are made anew as balls around what is below, unless the tree is drawn by them. Then they are kept as powers of 2,
  rounded up. One that held its subtree holds it still.
- Clusters keep their rows and centres; their radii and boxes are made anew by every reader of a ``.splatree``.

Left out are the order of equal depths (`ids`) and what merging has to know to go on above the roots. Cost of reading: about
5 CPU-seconds a million leaves.
"""

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, cast, get_args

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.io.budget import RowBudget
from splatree.io.check import checked_rows, refuse_unusable
from splatree.io.chunks import chunks_of
from splatree.io.formats.sog.reader import rows_of_files
from splatree.io.formats.sog.writer import encode
from splatree.io.formats.splatree.container import COMPACT_VERSION, Container
from splatree.io.formats.splatree.fields import NOT_STORED, columns_of, values_of
from splatree.io.formats.splatree.inner import (
    STEPS,
    gaussians_of,
    inner_from_codes,
    inner_of,
    inner_to_codes,
    suggested,
)
from splatree.io.formats.splatree.packing import WIDTHS, inflated, pack, unpack
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows
from splatree.maths.forests import ends_from_depth, subtree_radii
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import has_extents_of_levels
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.scene import Scene
from splatree.scene.thinning import Weight
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32

__all__ = ["CompactLeaves", "compacted", "leaves_alone", "lost_by_it", "uncompacted"]

_EXTENT_STEP = 1 / 1024
"""Octaves: 0.07 %."""

_NO_EXTENT = -(2**20)
"""Code of an extent of 0."""

_VALUES = {"levels": 1, "curves": 3, "means": 3, "shapes": 6, "opacities": 1, "extents": 1}
"""Values of a node in each table; those of harmonics, ``sh0`` on, have three."""

_OPTIONAL = ("levels", "curves", "extents")

_LEAVES, _NODES, _CLUSTERS = "leaves/", "nodes/", "clusters."
"""Where the names of columns begin that hold pictures of leaves, tables of merged nodes, and clusters."""


def lost_by_it(scene: Scene) -> tuple[str, ...]:
    """What a compact file does not hold of a scene, a sentence each."""
    lost = ["precision: a compact splatree rounds values to steps of its own"]
    if scene.ids is not None:
        lost.append("the order in which splats of equal depth are blended: a compact splatree takes that of its rows")
    if scene.tree.roots is not None:
        lost.append("what merging has to know to go on above the roots: build the levels again for that")
    return tuple(lost)


def compacted(scene: Scene) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns and strings of the file.

    Raises:
        InputError: a value cannot be used or coded.
    """
    refuse_unusable(scene.gaussians, "scene to write")
    is_leaf = scene.tree.is_leaf
    leaves = Scene.flat(scene.gaussians.take(is_leaf), mode=scene.mode)
    pictures, meta = encode(chunks_of(leaves), WriteOptions(), order="kept")
    files = {"meta.json": json.dumps(meta).encode(), **pictures}
    blobs = {_LEAVES + name: data for name, data in files.items()}
    about: dict[str, Any] = {"rows": len(scene)}
    if not is_leaf.all():
        record = scene.tree.record
        weight = "opacity" if record is None or record.merge is None else record.merge.weight or "opacity"
        packed = {
            name: pack(table, name) for name, table in _tables_of(scene, _gaussians_of(files, "leaves"), weight).items()
        }
        about |= {"weight": weight, "steps": STEPS, "bytes": {name: width for name, (_, width) in packed.items()}}
        blobs |= {_NODES + name: data for name, (data, _) in packed.items()}
        blobs[_NODES + "depth"] = zlib.compress(scene.tree.depth.tobytes(), 6)
    columns: dict[str, Array] = {name: np.frombuffer(data, np.uint8) for name, data in blobs.items()}
    if scene.clusters is not None:
        columns |= {"clusters.start": scene.clusters.start, "clusters.centers": scene.clusters.centers}
    kept = replace(scene, blocks=None, ids=None, tree=replace(scene.tree, roots=None))
    values = {name: value for name, value in values_of(kept, "") if name not in NOT_STORED}
    return columns, {**values, "version": str(COMPACT_VERSION), "compact": json.dumps(about)}


def _tables_of(scene: Scene, leaves: Gaussians, weight: Weight) -> dict[str, Array]:
    """What differs of merged nodes from what the leaves, as they are in the file, suggest."""
    tree, is_leaf = scene.tree, scene.tree.is_leaf
    curves = None if tree.curves is None else tree.curves[~is_leaf]
    by_leaves = suggested(tree.subtree_end, tree.depth, leaves, weight)
    tables = inner_to_codes(inner_of(scene.gaussians.take(~is_leaf), curves), by_leaves)
    given = tree.extents[~is_leaf]
    if has_extents_of_levels(tree.record):
        tables["extents"] = _codes_of_extents(given)
    elif tree.record is None or tree.record.profile in EXTENT_PROFILES:
        rounded = {name: np.rint(table) for name, table in tables.items()}
        inner = gaussians_of(inner_from_codes(rounded, by_leaves, STEPS))
        balls = [
            subtree_radii(g.means, g.reach(), tree.depth)[~is_leaf]
            for g in (scene.gaussians, _in_rows(is_leaf, leaves, inner))
        ]
        tables["extents"] = _codes_of_extents(np.where(given >= balls[0], np.maximum(given, balls[1]), given))
    return tables


def uncompacted(file: Container) -> dict[str, Array]:
    """The columns of the scene, by the names that they have in an exact file.

    Raises:
        FormatError: the file is damaged.
    """
    where, (about, num_rows) = str(file.path), _about(file)
    leaves, nodes = (_blobs(file, prefix) for prefix in (_LEAVES, _NODES))
    clusters = {name: file.rows(name) for name in file.columns if name.startswith(_CLUSTERS)}
    return _columns_from(_gaussians_of(leaves, where), nodes, about, num_rows, where) | clusters


@dataclass(frozen=True, eq=False)
class CompactLeaves:
    """The leaves of a compact file, decoded when they are asked for."""

    rows: FileRows
    """The leaves; their pictures are decoded and kept, 17 to 20 bytes a leaf."""
    num_rows: int
    """Rows of the scene, merged nodes included."""
    num_clusters: int
    """Clusters of the scene."""


def leaves_alone(file: Container) -> CompactLeaves:
    """The leaves, in the order of the tree; merged nodes are not read.

    Raises:
        FormatError: the file is damaged.
    """
    where, (_, num_rows), centers = str(file.path), _about(file), file.columns.get(f"{_CLUSTERS}centers")
    rows = rows_of_files(_blobs(file, _LEAVES), where)
    if rows.num_rows > num_rows:
        raise FormatError(f"{where}: found {rows.num_rows} leaves in pictures, wanted at most {num_rows} rows")
    return CompactLeaves(rows, num_rows, 0 if centers is None else centers.shape[0])


def _about(file: Container) -> tuple[dict[str, Any], int]:
    """What the header says of a compact file, and how many rows the scene has."""
    where = str(file.path)
    for name in file.columns:
        if not name.startswith((_LEAVES, _NODES, _CLUSTERS)):
            raise FormatError(
                f"{where}: found the column {name[:80]!r}, which no compact file has; the file is damaged"
            )
    text = untrusted.text(file.values, "compact", where)
    about = untrusted.as_object(untrusted.parse_json(text.encode(), where), f"{where}: compact")
    num_rows = untrusted.integer(about, "rows", f"{where}: compact")
    budget = RowBudget(where)
    budget.add_file(file.path)
    budget.take(num_rows)
    return about, num_rows


def _blobs(file: Container, prefix: str) -> dict[str, bytes]:
    """Columns of bytes by what follows the prefix in their names."""
    blobs = {}
    for name in file.columns:
        if name.startswith(prefix):
            blob = file.rows(name)
            if blob.dtype != np.uint8 or blob.ndim != 1:
                raise FormatError(f"{file.path}: {name}: found {blob.dtype.name} of shape {blob.shape}, wanted bytes")
            blobs[name.removeprefix(prefix)] = blob.tobytes()
    return blobs


def _gaussians_of(files: Mapping[str, bytes], where: str) -> Gaussians:
    return rows_of_files(files, where).scene(ReadOptions()).gaussians


def _columns_from(
    leaves: Gaussians, blobs: Mapping[str, bytes], about: Mapping[str, Any], num_rows: int, where: str
) -> dict[str, Array]:
    depth = np.zeros(num_rows, np.uint8)
    if blobs:
        depth = np.frombuffer(inflated(_blob(blobs, "depth", where), num_rows, f"{where}: nodes/depth"), np.uint8)
    if num_rows and (depth[0] != 0 or np.any(depth[1:] > depth[:-1].astype(np.int16) + 1)):
        raise FormatError(f"{where}: nodes/depth: found a jump of more than one level, wanted depth-first preorder")
    end = ends_from_depth(depth)
    is_leaf = np.asarray(end == np.arange(1, num_rows + 1))
    if np.count_nonzero(is_leaf) != len(leaves):
        raise FormatError(
            f"{where}: found {len(leaves)} leaves in pictures, wanted the {np.count_nonzero(is_leaf)} of the tree; the file is "
            "damaged"
        )
    if is_leaf.all():
        flat = Scene.flat(leaves)
        return dict(columns_of(flat, ""))
    tables = _tables_from(blobs, about, num_rows - len(leaves), leaves.sh.shape[1], where)
    weight, steps = _rules(about, where)
    codes = tables.pop("extents", None)
    inner = inner_from_codes(tables, suggested(end, depth, leaves, weight), steps)
    g, _ = checked_rows(_in_rows(is_leaf, leaves, gaussians_of(inner)), where, repair=False)
    largest = np.finfo(np.float32).max
    if codes is None:
        extents = subtree_radii(g.means, g.reach(), depth)
    else:
        extents = np.nextafter(np.minimum(g.reach(), largest).astype(np.float32), largest)
        extents[~is_leaf] = _extents_from(codes[:, 0])
    curves = None
    if inner.curves is not None:
        curves = np.zeros((num_rows, 4), np.float32)
        curves[~is_leaf] = inner.curves
    return dict(columns_of(Scene(g, GaussianTree(end, depth, extents, curves)), ""))


def _in_rows(is_leaf: Array, leaves: Gaussians, inner: Gaussians) -> Gaussians:
    """Leaves and merged nodes in the rows of the tree."""
    columns = {}
    for f in fields(Gaussians):
        column = np.empty((len(is_leaf), *getattr(leaves, f.name).shape[1:]), np.float32)
        column[is_leaf], column[~is_leaf] = getattr(leaves, f.name), getattr(inner, f.name)
        columns[f.name] = column
    return Gaussians(**columns)


def _rules(about: Mapping[str, Any], where: str) -> tuple[Weight, dict[str, float]]:
    """What the header says of weights and quanta."""
    weight = untrusted.text(about, "weight", f"{where}: compact")
    if weight not in get_args(Weight):
        raise FormatError(f"{where}: compact.weight: found {weight[:40]!r}, wanted {' or '.join(get_args(Weight))}")
    given = untrusted.as_object(untrusted.field(about, "steps", f"{where}: compact"), f"{where}: compact.steps")
    steps = {name: untrusted.number(given, name, f"{where}: compact.steps") for name in STEPS}
    for name, step in steps.items():
        if not 1e-6 <= step <= 1e3:
            raise FormatError(f"{where}: compact.steps.{name}: found {step}, wanted 1e-6 to 1000; the file is damaged")
    return cast(Weight, weight), steps


def _tables_from(
    blobs: Mapping[str, bytes], about: Mapping[str, Any], num_nodes: int, num_harmonics: int, where: str
) -> dict[str, Array]:
    widths = untrusted.as_object(untrusted.field(about, "bytes", f"{where}: compact"), f"{where}: compact.bytes")
    wanted = _VALUES | {f"sh{i}": 3 for i in range(num_harmonics)}
    names = [name for name in wanted if name in blobs or name not in _OPTIONAL]
    if ("levels" in names) != ("curves" in names) or set(blobs) - {*names, "depth"}:
        raise FormatError(f"{where}: found the tables {sorted(blobs)}, wanted {', '.join(wanted)}; the file is damaged")
    tables = {}
    for name in names:
        width = untrusted.integer(widths, name, f"{where}: compact.bytes", low=1, high=max(WIDTHS))
        if width not in WIDTHS:
            raise FormatError(f"{where}: compact.bytes.{name}: found {width}, wanted one of {WIDTHS}")
        tables[name] = unpack(_blob(blobs, name, where), num_nodes, wanted[name], width, f"{where}: nodes/{name}")
    return tables


def _blob(blobs: Mapping[str, bytes], name: str, where: str) -> bytes:
    if name not in blobs:
        raise FormatError(f"{where}: found no column 'nodes/{name}', only {sorted(blobs)}; the file is damaged")
    return blobs[name]


def _codes_of_extents(extents: Float32[Array, "i"]) -> Array:
    """The least codes whose extents are not less than these."""
    positive = extents > 0
    codes = np.ceil(np.log2(np.where(positive, extents, 1).astype(np.float64)) / _EXTENT_STEP)
    codes += _extents_from(codes) < extents  # a last bit of the logarithm
    return np.where(positive, codes, _NO_EXTENT)[:, None]


def _extents_from(codes: Array) -> Float32[Array, "i"]:
    extents = np.exp2(np.clip(codes * _EXTENT_STEP, -149.0, 127.99)).astype(np.float32)
    return np.where(codes == _NO_EXTENT, np.float32(0), extents)
