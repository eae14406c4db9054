"""``.hier`` (Hierarchical 3DGS, Kerbl 2024): Gaussians and the nodes of a tree over them, in float32 or in half precision.

One array after the other, little-endian:

==========================  ==========================================  ============================================
array                       float32 (P ≥ 0)                             half (P < 0)
==========================  ==========================================  ============================================
number of Gaussians         i4 P                                        i4 −P
means                       3 f4                                        3 f4
quats wxyz                  4 f4                                        4 f2
log-scales                  3 f4                                        3 f2
opacities, linear           f4                                          f2
harmonics, 16 RGB           48 f4                                       48 f2
number of nodes             i4 N                                        i4 N
nodes                       i4 depth parent start leafs merged          i4 parent start first_child,
                            first_child children                        i2 depth children leafs merged
boxes                       4 f4 min, 4 f4 max                          4 f2 min, 4 f2 max
==========================  ==========================================  ============================================

A node owns the Gaussians ``start …``: ``merged`` that stand for its subtree, or ``leafs`` of the scene. One merged Gaussian is a
node of ours. A node with none or several only joins its children (chunks of a large scene): they move up to its parent, and
its stand-ins, which our tree cannot draw together, are left out and counted. Opacities above 1 are read as wider Gaussians
(`splatree.io.opacities`). Written and read from a description of the layout alone. docs/reference/formats/hier.md.

Gaussians are written in preorder, nodes breadth-first, so that writing and reading back gather nothing.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splatree.constants import SIGMAS
from splatree.errors import FormatError, InputError
from splatree.io.check import checked_rows, refuse_unusable
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows
from splatree.io.levels import FileLevels, preorder_of_file, scene_with_levels
from splatree.io.notes import gaussians_in_words
from splatree.io.objects import ObjectPath
from splatree.io.opacities import areas_of_clamped, logits_from_opacities, opacities_from_logits
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows, records_of
from splatree.io.runs import TreeRuns
from splatree.maths.forests import family_extremes, links_from_preorder, parents_by_level, subtree_radii
from splatree.maths.rotations import matrices_from_quats
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import UNKNOWN_LEVELS
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array, Bool, Float32, Int32, UInt8

_NODE = np.dtype([(name, "<i4") for name in ("depth", "parent", "start", "leafs", "merged", "first_child", "children")])
_HALF_NODE = np.dtype(
    [(name, "<i4") for name in ("parent", "start", "first_child")]
    + [(name, "<i2") for name in ("depth", "children", "leafs", "merged")]
)
_WIDTHS = (3, 4, 3, 1, 48)
"""Values of a Gaussian in each array: means, quats, log-scales, opacity, harmonics."""

_HALF_MAX = 65504.0
"""Largest finite half-precision number."""

_READ_BYTES = 300
"""What reading takes for each Gaussian at most, in either layout: 236 for its columns, the rest to put nodes into preorder."""

_ROWS_AT_ONCE = 1 << 16


Rows = slice | Array


def sniff(path: Path, head: bytes) -> bool:
    """Whether the sizes that its two counts announce make up the file: nothing else marks it."""
    if len(head) < 8 or not path.is_file():
        return False
    num_gaussians = int(np.frombuffer(head, "<i4", 1)[0])
    with path.open("rb") as file:
        file.seek(_bytes_before_nodes(num_gaussians) - 4)
        count = file.read(4)
    num_nodes = int.from_bytes(count, "little", signed=True)
    return (
        len(count) == 4
        and num_nodes > 0
        and path.stat().st_size == _bytes_before_nodes(num_gaussians) + num_nodes * _bytes_per_node(num_gaussians < 0)
    )


def whole_bytes(path: Path) -> int:
    """Memory that reading takes, by the number of Gaussians that the file announces and has bytes for."""
    with path.open("rb") as file:
        count = _read_count(path, file)
    before = _bytes_before_nodes(-1 if count < 0 else 1) - 8
    return _READ_BYTES * min(abs(count), path.stat().st_size // before)


def read(path: Path, options: ReadOptions) -> Scene:
    """Read either layout; its nodes become the tree."""
    tree = _open(path)
    gaussians, levels = tree.file_rows().unchecked_scene().gaussians, FileLevels(tree.subtree_end, tree.depth)
    scene = scene_with_levels(gaussians, levels, str(path), repair=options.repair, num_opaque=0)
    return replace(scene, source=replace(scene.source, metadata={**tree.metadata, **scene.source.metadata}))


def read_leaves(path: Path, options: ReadOptions) -> Chunks | None:
    """The leaves in chunks; None for an object of a store, and where values may be repaired, which trees do not bear."""
    if options.repair or isinstance(path, ObjectPath):
        return None
    tree = _open(path)
    leaves = tree.file_rows(tree.gaussian_from_row[tree.is_leaf]).chunks(options)
    return replace(leaves, num_merged=len(tree) - len(leaves))


def read_runs(path: Path) -> TreeRuns | None:
    """The rows with their levels; None for an object of a store."""
    if isinstance(path, ObjectPath):
        return None
    tree, where = _open(path), str(path)
    n = len(tree)
    rows, has_levels = tree.file_rows(), bool(tree.depth.any())
    extents = _extents(tree, rows) if has_levels else None

    def runs(what: str) -> Iterator[SceneRows]:
        begin = 0
        with task(what, float(n)) as advance:
            for part, _ in rows.parts():
                end = begin + len(part)
                part, _ = checked_rows(part, where, repair=False, first_row=begin)
                own = Scene.flat(part).tree.extents if extents is None else extents[begin:end]
                yield SceneRows(begin, part, tree.subtree_end[begin:end], tree.depth[begin:end], own, ids=None)
                begin = end
                advance(float(len(part)))

    record, source = UNKNOWN_LEVELS if has_levels else None, Source(metadata=tree.metadata)
    head = SceneHead(n, rows.sh_degree, record=record, source=source)
    return TreeRuns(head, int(np.count_nonzero(tree.is_leaf)), runs)


def _extents(tree: "_Tree", rows: FileRows) -> Float32[Array, "n"]:
    """Balls around what is below each row; 40 bytes a row while they are found."""
    means, reach, begin = np.empty((len(tree), 3), np.float32), np.empty(len(tree)), 0
    for part, _ in rows.parts():
        part, _ = checked_rows(part, rows.where, repair=False, first_row=begin)
        end = begin + len(part)
        means[begin:end], reach[begin:end] = part.means, part.reach()
        begin = end
    return subtree_radii(means, reach, tree.depth)


@dataclass(frozen=True, eq=False)
class _Tree:
    """A file whose nodes have been put into preorder, and whose Gaussians are read when they are asked for."""

    path: Path
    is_half: bool
    columns: list[Array]
    """The arrays of the Gaussians, mapped; of an object of a store, in memory."""
    gaussian_from_row: Int32[Array, "n"]
    subtree_end: Int32[Array, "n"]
    depth: UInt8[Array, "n"]
    metadata: dict[str, str]

    def __len__(self) -> int:
        return len(self.gaussian_from_row)

    @property
    def is_leaf(self) -> Bool[Array, "n"]:
        """Whether each row is a leaf."""
        return np.asarray(self.subtree_end == np.arange(1, len(self) + 1, dtype=np.int32))

    def file_rows(self, chosen: Array | None = None) -> FileRows:
        """Some Gaussians by their numbers in the file; None: all rows."""
        numbers = self.gaussian_from_row if chosen is None else chosen

        def fill(begin: int, out: Gaussians) -> None:
            _decode([_taken(column, numbers[begin : begin + len(out)]) for column in self.columns], out, self.is_half)

        return FileRows(
            *(str(self.path), len(numbers), self._sh_degree, lambda: nullcontext(fill)), metadata=self.metadata
        )

    @cached_property
    def _sh_degree(self) -> int:
        """Scenes of lower degree are padded with zeros; as a rule the first rows tell."""
        degree = 0
        for begin in range(0, len(self), ROWS_PER_CHUNK):
            values = _taken(self.columns[4], self.gaussian_from_row[begin : begin + ROWS_PER_CHUNK]).reshape(-1, 16, 3)
            is_used = values != 0  # `any` of floats warns of signalling NaN
            degree = max([degree, *(d for d in (1, 2, 3) if is_used[:, d * d : (d + 1) ** 2].any())])
            if degree == 3:
                break
        return degree


def _open(path: Path) -> _Tree:
    """Check the frame of the file, and put its nodes into preorder."""
    num_bytes = path.stat().st_size
    with path.open("rb") as file, task(f"read {path.name}", num_bytes) as advance:
        num_gaussians = _read_count(path, file)
        is_half, num_gaussians = num_gaussians < 0, abs(num_gaussians)
        before = _bytes_before_nodes(-num_gaussians if is_half else num_gaussians)
        if num_bytes < before:
            raise FormatError(
                f"{path}: found {num_bytes} bytes, wanted {before} for the {num_gaussians} "
                f"{'half' if is_half else 'float32'} Gaussians that it announces; the file is cut off or no .hier"
            )
        types = ("<f4", *4 * ("<f2",)) if is_half else 5 * ("<f4",)
        columns = [
            _array_of(path, file, np.dtype(dtype), num_gaussians * width).reshape(num_gaussians, width)
            for dtype, width in zip(types, _WIDTHS, strict=True)
        ]
        num_nodes = _read_count(path, file)
        wanted = before + num_nodes * _bytes_per_node(is_half)
        if num_nodes < 0 or num_bytes != wanted:
            raise FormatError(
                f"{path}: found {num_bytes} bytes, wanted {wanted} for {num_gaussians} Gaussians and {num_nodes} nodes; the file "
                "is cut off or damaged"
            )
        nodes = _array_of(path, file, _HALF_NODE if is_half else _NODE, num_nodes)  # the boxes are not asked for
        advance(num_bytes)
    gaussian_from_row, subtree_end, depth, num_left_out = _rows(nodes, num_gaussians, str(path))
    num_opaque = sum(
        int(np.count_nonzero(_taken(columns[3], gaussian_from_row[begin : begin + _ROWS_AT_ONCE]) > 1))
        for begin in range(0, len(gaussian_from_row), _ROWS_AT_ONCE)
    )
    metadata = {"precision": "half" if is_half else "float32"}
    if num_opaque:
        metadata["opacities_above_one"] = json.dumps({"read_as_wider": num_opaque})
    if num_left_out:
        metadata["joining_nodes"] = json.dumps({"gaussians_left_out": num_left_out})
    return _Tree(path, is_half, columns, gaussian_from_row, subtree_end, depth, metadata)


def _array_of(path: Path, file: BinaryIO, dtype: "np.dtype[Any]", count: int) -> Array:
    """The next values of a file: mapped, so that those are read that are asked for; of an object of a store, fetched."""
    if count == 0 or isinstance(path, ObjectPath):
        return records_of(file, dtype, count)
    begin = file.tell()
    mapped = np.memmap(file, dtype, "r", begin, (count,))
    file.seek(begin + mapped.nbytes)
    return np.asarray(mapped)


def _taken(column: Array, numbers: Array) -> Array:
    """Rows of a column; those that follow each other are not gathered."""
    first = int(numbers[0]) if len(numbers) else 0
    if np.array_equal(numbers, np.arange(first, first + len(numbers))):
        return column[first : first + len(numbers)]
    return np.take(column, numbers, axis=0)


def _bytes_before_nodes(num_gaussians: int) -> int:
    """Bytes of both counts and the Gaussians; a negative number marks the half layout, as in the file."""
    each = 12 + 2 * sum(_WIDTHS[1:]) if num_gaussians < 0 else 4 * sum(_WIDTHS)
    return 8 + abs(num_gaussians) * each


def _bytes_per_node(is_half: bool) -> int:
    return _HALF_NODE.itemsize + 16 if is_half else _NODE.itemsize + 32


def _read_count(path: Path, file: BinaryIO) -> int:
    count = file.read(4)
    if len(count) < 4:
        raise FormatError(
            f"{path}: found the end of the file in a count, wanted 4 bytes; the file is cut off or no .hier"
        )
    return int.from_bytes(count, "little", signed=True)


def _rows(nodes: Array, num_gaussians: int, where: str) -> tuple[Array, Array, Array, int]:
    """Gaussian, subtree end and depth of each row, and how many stand-ins of joining nodes are left out.

    Memory: some 60 bytes a node at most.
    """
    num_owned = sum(
        _checked_nodes(nodes[first : first + _ROWS_AT_ONCE], first, num_gaussians, where)
        for first in range(0, len(nodes), _ROWS_AT_ONCE)
    )
    if num_owned > num_gaussians:
        raise FormatError(
            f"{where}: found nodes that own {num_owned} Gaussians, wanted at most the {num_gaussians} there are"
        )
    roots = np.flatnonzero(nodes["parent"] < 0)
    order = preorder_of_file(nodes["first_child"], nodes["children"], roots, where)

    for rows, parent_rows in parents_by_level(order.depth):
        wrong = nodes["parent"][order.node_from_row[rows]] != order.node_from_row[parent_rows]
        if wrong.any():
            i, parent = (int(order.node_from_row[x[np.argmax(wrong)]]) for x in (rows, parent_rows))
            raise FormatError(
                f"{where}: node {i}: found parent {nodes['parent'][i]}, wanted {parent}, whose child it is"
            )

    row = order.node_from_row  # of nodes; below, rows are those of Gaussians
    is_own = (nodes["merged"] == 1)[row]
    owned = np.where(is_own, 1, nodes["leafs"][row]).astype(np.int32)
    end = np.zeros(len(row) + 1, np.int32)
    np.cumsum(owned, out=end[1:])
    is_joining = ~is_own & (nodes["children"] > 0)[row]
    # A joining node lifts the nodes below it by one level: +1 behind it, −1 at the end of its subtree.
    steps = np.zeros(len(row) + 1, np.int16)
    steps[1:] += is_joining
    np.subtract.at(steps, order.subtree_end[is_joining], 1)
    lifted = (order.depth - np.cumsum(steps, dtype=np.int16)[:-1]).astype(np.uint8)
    del steps

    gaussian_from_row = np.repeat(nodes["start"][row] - end[:-1], owned)
    numbers = np.arange(len(gaussian_from_row), dtype=np.int32)
    gaussian_from_row += numbers
    numbers += 1
    subtree_end = np.where(np.repeat(is_own, owned), np.repeat(end[order.subtree_end], owned), numbers)
    num_left_out = int(nodes["merged"].sum(dtype=np.int64)) - int(np.count_nonzero(is_own))
    return gaussian_from_row, subtree_end, np.repeat(lifted, owned), num_left_out


def _checked_nodes(nodes: Array, first: int, num_gaussians: int, where: str) -> int:
    """How many Gaussians nodes own, of which ``first`` is the first."""
    start, leafs, merged, children = (nodes[name].astype(np.int64) for name in ("start", "leafs", "merged", "children"))

    def refuse(wrong: Array, found: str, wanted: str) -> None:
        if wrong.any():
            i = int(np.argmax(wrong))
            record = " ".join(f"{name} {nodes[name][i]}" for name in nodes.dtype.names or ())
            raise FormatError(
                f"{where}: node {first + i}: found {found} ({record}), wanted {wanted}; the file is damaged"
            )

    refuse((leafs < 0) | (merged < 0), "a negative count", "0 or more")
    refuse((leafs > 0) & ((merged > 0) | (children > 0)), "Gaussians of the scene at an inner node", "them at leaves")
    claimed = leafs + merged
    refuse(
        (claimed > 0) & ((start < 0) | (start + claimed > num_gaussians)),
        "a range",
        f"Gaussians 0 to {num_gaussians - 1}",
    )
    return int(np.where(merged == 1, 1, leafs).sum())


def _decode(columns: list[Array], out: Gaussians, is_half: bool) -> None:
    """Values of the file into columns of a scene."""
    means, quats, log_scales, opacities, harmonics = columns
    opacities = opacities.reshape(len(out))
    out.means[:], out.quats[:], out.log_scales[:] = means, quats, log_scales
    above = np.flatnonzero(opacities > 1)
    with np.errstate(invalid="ignore"):  # an infinite opacity: the check of values names its row
        out.log_scales[above] += 0.5 * np.log(areas_of_clamped(opacities[above]))[:, None]
    step_low, step_high = (2.0**-24, 2.0**-11) if is_half else (2.0**-148, 2.0**-24)
    out.logit_opacities[:] = logits_from_opacities(opacities, step_low=step_low, step_high=step_high)
    out.sh[:] = harmonics.reshape(len(out), 16, 3)[:, : out.sh.shape[1]]


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write float32 (compression 0, the default) or half precision (1).

    Several roots get a node above them that joins them, with copies of them as its stand-ins; a scene without levels is one
    node with all of its Gaussians.

    Raises:
        InputError: half precision cannot hold a coordinate or a count.
    """
    if options.compression not in (None, 0, 1):
        raise InputError(
            f"{path.name}: found compression {options.compression}, wanted 0 (float32) or 1 (half precision)"
        )
    is_half = options.compression == 1
    g, n = scene.gaussians, len(scene)
    refuse_unusable(g, "scene to write")
    nodes, copied = _nodes(scene)
    low, high = _corners(scene)
    if is_half and n:
        _check_half(nodes, low, high)
    parts: list[Rows] = [slice(begin, begin + _ROWS_AT_ONCE) for begin in range(0, n, _ROWS_AT_ONCE)]
    # [n w] of each array, a part at a time
    columns: tuple[Callable[[Rows], Array], ...] = (
        lambda rows: g.means[rows],
        lambda rows: _unit(g.quats[rows]) if is_half else g.quats[rows],
        lambda rows: g.log_scales[rows],
        lambda rows: opacities_from_logits(g.logit_opacities[rows]),
        lambda rows: _padded(g.sh[rows]),
    )
    num_gaussians, num_clamped = n + len(copied), 0
    with path.open("wb") as file, task(f"write {path.name}", len(columns)) as advance:
        file.write((-num_gaussians if is_half else num_gaussians).to_bytes(4, "little", signed=True))
        for i, column in enumerate(columns):
            for rows in [*parts, copied]:
                values = column(rows)
                if is_half and i > 0:
                    if rows is not copied:
                        num_clamped += int((np.abs(values.reshape(len(values), -1)) > _HALF_MAX).any(axis=1).sum())
                    values = np.clip(values, -_HALF_MAX, _HALF_MAX).astype("<f2")
                file.write(np.ascontiguousarray(values).data)
            advance(1)
        file.write(len(nodes).to_bytes(4, "little"))
        file.write(_half_nodes(nodes).data if is_half else nodes.data)
        for boxes in _packed_boxes(nodes, low, high, np.dtype("<f2" if is_half else "<f4")):
            file.write(boxes.data)
    return (f"harmonics beyond ±{_HALF_MAX:g}: clamped in {gaussians_in_words(num_clamped)}",) if num_clamped else ()


def _nodes(scene: Scene) -> tuple[Array, Array]:
    """Nodes, breadth-first, and the rows that are written once more as stand-ins of a node that joins several roots."""
    n, tree = len(scene), scene.tree
    if n and tree.num_leaves == n:
        return np.array([(0, -1, 0, n, 0, 0, 0)], _NODE), np.zeros(0, np.intp)
    links = links_from_preorder(tree.depth)
    num_roots = int(np.count_nonzero(tree.depth == 0))
    above = int(num_roots > 1)  # how many nodes stand before ours
    nodes = np.zeros(above + n, _NODE)
    ours = nodes[above:]
    is_leaf = links.num_children == 0
    ours["depth"] = tree.depth[links.row_from_node] + np.uint8(above)
    ours["parent"] = links.parents + above
    ours["start"] = links.row_from_node
    ours["leafs"], ours["merged"] = is_leaf, ~is_leaf
    ours["first_child"] = np.where(is_leaf, 0, links.first_child + above)
    ours["children"] = links.num_children
    if above:
        nodes[0] = (0, -1, n, 0, num_roots, 1, num_roots)
    elif n:
        ours["parent"][0] = -1
    return nodes, links.row_from_node[:num_roots] if above else np.zeros(0, np.intp)


def _corners(scene: Scene) -> tuple[Array, Array]:
    """Corners "n+1 3" of a box around the 3σ ellipsoids of each row's subtree; the last box holds all."""
    g, n = scene.gaussians, len(scene)
    low, high = np.full((n + 1, 3), np.inf), np.full((n + 1, 3), -np.inf)
    for begin in range(0, n, _ROWS_AT_ONCE):
        rows = slice(begin, min(begin + _ROWS_AT_ONCE, n))
        axes = matrices_from_quats(g.quats[rows]) * np.exp(g.log_scales[rows].astype(np.float64))[:, None, :]
        reach = SIGMAS * np.sqrt(np.einsum("nij,nij->ni", axes, axes))  # √Σ_ii along axis i of the world
        low[rows], high[rows] = g.means[rows] - reach, g.means[rows] + reach
    family_extremes(low[:n], high[:n], scene.tree.depth)
    low[n], high[n] = low.min(axis=0), high.max(axis=0)
    return low, high


def _packed_boxes(nodes: Array, low: Array, high: Array, dtype: np.dtype[Any]) -> Iterator[Array]:
    """Boxes as they are written, some at a time, rounded outwards; the fourth value of both corners is the longest side."""
    for begin in range(0, len(nodes), _ROWS_AT_ONCE):
        part = nodes[begin : begin + _ROWS_AT_ONCE]
        holds_all = (part["leafs"] > 1) | (part["merged"] > 1)
        row = np.where(holds_all, len(low) - 1, part["start"])
        boxes = np.empty((len(part), 2, 4), dtype)
        boxes[:, 0, :3] = np.nextafter(low[row].astype(dtype), dtype.type(-np.inf))
        boxes[:, 1, :3] = np.nextafter(high[row].astype(dtype), dtype.type(np.inf))
        boxes[:, :, 3] = (high[row] - low[row]).max(axis=1)[:, None]
        yield boxes


def _check_half(nodes: Array, low: Array, high: Array) -> None:
    """Refuse what 16 bits cannot hold."""
    limit = np.iinfo(np.int16).max
    for name in ("children", "leafs", "merged"):
        largest = int(nodes[name].max(initial=0))
        if largest > limit:
            raise InputError(
                f"node {int(nodes[name].argmax())}: found {largest} {name}, wanted at most {limit} in half precision; write "
                "float32 (compression 0), or build levels with fewer children a node"
            )
    reach = max(float(-low[-1].min()), float(high[-1].max()), float((high[-1] - low[-1]).max()))
    if reach >= _HALF_MAX:
        raise InputError(
            f"boxes of nodes: found a coordinate or side of {reach:.6g}, wanted less than {_HALF_MAX:.6g} in half precision; "
            "write float32 (compression 0)"
        )


def _half_nodes(nodes: Array) -> Array:
    half = np.empty(len(nodes), _HALF_NODE)
    for name in _NODE.names or ():
        half[name] = nodes[name]
    return half


def _unit(quats: Array) -> Array:
    return np.asarray(quats / np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True))


def _padded(sh: Array) -> Array:
    """Harmonics "n 48"; those above the scene's degree are zero."""
    if sh.shape[1] == 16:
        return sh.reshape(len(sh), 48)
    values = np.zeros((len(sh), 48), np.float32)
    values[:, : 3 * sh.shape[1]] = sh.reshape(len(sh), 3 * sh.shape[1])
    return values
