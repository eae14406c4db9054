"""The whole tree of a folder, read in runs of rows: what is larger than memory is gone through.

Each row of the crown stands for itself; the copy of a root stands for the subtree of the root, which a part holds. So where a row
of the whole tree lies follows from the sizes of these subtrees. Rows are gathered from the mapped files.

Memory: 24 bytes a row of the crown, and what the rows that are asked for take.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from shutil import copyfileobj, rmtree
from tempfile import mkdtemp
from weakref import finalize

import numpy as np

from splatree.errors import FormatError, InputError, ShapeError
from splatree.io.check import checked_rows
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, StoredFile, checked_path, read_manifest
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows, StoredScene, open_scene
from splatree.io.levels import check_extents
from splatree.io.objects import ObjectPath
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Int32, Int64, UInt8

__all__ = ["WholeTree", "open_whole"]


class Brought:
    """A temporary folder, removed when nothing holds this any more."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        finalize(self, rmtree, folder, ignore_errors=True)


@dataclass(frozen=True, eq=False)
class WholeTree:
    """The tree of a folder, whose rows are read when they are asked for."""

    path: Path
    """The folder."""
    head: SceneHead
    """How many rows there are, and how they are drawn."""
    num_leaves: int
    """Leaves."""
    files: tuple[StoredScene, ...]
    """The crown and the parts."""
    first_row: Int64[Array, "s+1"]
    """The row in the whole of each row of the crown; behind the last one the number of rows."""
    file_of: Int32[Array, "s"]
    """Where each row of the crown is read: 0 in the crown itself, i in part i."""
    row_of: Int32[Array, "s"]
    """The row there; of a copy, that of its root."""
    first_id: int
    """The identity of a merged node is this and its row."""
    brought: "Brought | None" = None
    """Where the files are that lie on a server or an object store, for as long as they are needed."""

    def __len__(self) -> int:
        return self.head.num_rows

    def rows(self, begin: int, end: int) -> SceneRows:
        """Rows of the whole tree; their values have been checked.

        Raises:
            FormatError: a value cannot be used, or a node is too deep.
        """
        rows = np.arange(begin, end)
        places = self._placed(rows)
        ends, depth = self._shape(places)
        extents, ids = np.empty(len(rows), np.float32), rows + self.first_id
        curves = np.zeros((len(rows), 4), np.float32) if self.head.has_curves else None
        is_leaf = ends == rows + 1
        for number, at, own in places.by_file():
            stored = self.files[number]
            extents[at] = _taken(stored, "tree.extents", own)
            if curves is not None:
                curves[at] = _taken(stored, "tree.curves", own)
            if number > 0:
                own_ids = _taken(stored, "ids", own) if stored.head.has_ids else own
                ids[at] = np.where(is_leaf[at], own_ids, ids[at])
        check_extents(extents, str(self.path), first_row=begin)
        gaussians = self._gaussians(places, begin)
        return SceneRows(begin, gaussians, ends, depth, extents, ids.astype(np.uint32), curves)

    def shape(self, begin: int, end: int) -> tuple[Int32[Array, "n"], UInt8[Array, "n"]]:
        """Where the subtrees of rows end, and their depths; nothing else of them is read.

        Raises:
            FormatError: a node is too deep.
        """
        return self._shape(self._placed(np.arange(begin, end)))

    def take(self, rows: Int64[Array, "v"]) -> Gaussians:
        """The Gaussians of rows, ascending; their values have been checked.

        Raises:
            FormatError: a value cannot be used.
        """
        return self._gaussians(self._placed(rows), int(rows[0]) if len(rows) else 0)

    def _placed(self, rows: Array) -> "_Places":
        nodes = np.searchsorted(self.first_row, rows, side="right") - 1
        shift = self.first_row[nodes] - self.row_of[nodes]
        return _Places(nodes, shift, self.file_of[nodes], rows - shift)

    def _shape(self, places: "_Places") -> tuple[Array, Array]:
        ends, depth = np.empty(len(places.own), np.int64), np.empty(len(places.own), np.int64)
        above = self.files[0].file.rows("tree.depth")
        for number, at, own in places.by_file():
            stops, depth[at] = (_taken(self.files[number], f"tree.{name}", own) for name in ("subtree_end", "depth"))
            if number == 0:
                ends[at] = self.first_row[stops]
            else:
                ends[at] = stops + places.shift[at]
                depth[at] += above[places.nodes[at]]
        if depth.max(initial=0) > 255:
            raise FormatError(f"{self.path}: found a node {depth.max()} levels below its root, wanted at most 255")
        return ends.astype(np.int32), depth.astype(np.uint8)

    def _gaussians(self, places: "_Places", first_row: int) -> Gaussians:
        columns = _room(len(places.own), self.head.sh_degree)
        for number, at, own in places.by_file():
            for name, column in columns.items():
                column[at] = _taken(self.files[number], f"gaussians.{name}", own)
        return checked_rows(Gaussians(**columns), str(self.path), repair=False, first_row=first_row)[0]

    def runs(self, what: str) -> Iterator[SceneRows]:
        """All rows, a chunk at a time; ``what`` names the work for who watches it."""
        with task(what, float(len(self))) as advance:
            for begin in range(0, len(self), ROWS_PER_CHUNK):
                rows = self.rows(begin, min(begin + ROWS_PER_CHUNK, len(self)))
                yield rows
                advance(float(len(rows)))

    def leaves(self) -> Chunks:
        """The leaves alone, as a flat scene in chunks."""

        def make() -> Iterator[Gaussians]:
            pending = Gaussians.empty(self.head.sh_degree)
            for begin in range(0, len(self), ROWS_PER_CHUNK):
                rows = self.rows(begin, min(begin + ROWS_PER_CHUNK, len(self)))
                is_leaf = rows.subtree_end == rows.begin + 1 + np.arange(len(rows))
                pending = Gaussians.concatenate([pending, rows.gaussians.take(np.flatnonzero(is_leaf))])
                if len(pending) >= ROWS_PER_CHUNK:
                    yield pending.rows(0, ROWS_PER_CHUNK)
                    pending = pending.rows(ROWS_PER_CHUNK, len(pending))
            if len(pending):
                yield pending

        source = self.head.source
        return Chunks(
            *(self.num_leaves, self.head.sh_degree, self.head.mode, make, source.metadata),
            origin=source.origin,
            paths=source.paths,
            format=source.format,
            threshold=self.head.threshold,
            num_merged=len(self) - self.num_leaves,
        )

    def scene(self) -> Scene:
        """All rows in memory."""
        n = len(self)
        columns = _room(n, self.head.sh_degree)
        ends, depth, extents = np.empty(n, np.int32), np.empty(n, np.uint8), np.empty(n, np.float32)
        ids = np.empty(n, np.uint32)
        curves = np.zeros((n, 4), np.float32) if self.head.has_curves else None
        for run in self.runs(f"read {self.path.name}"):
            at = slice(run.begin, run.begin + len(run))
            for name, column in columns.items():
                column[at] = getattr(run.gaussians, name)
            assert run.ids is not None
            ends[at], depth[at], extents[at], ids[at] = run.subtree_end, run.depth, run.extents, run.ids
            if curves is not None:
                curves[at] = run.curves
        head = self.head
        tree = GaussianTree(ends, depth, extents, curves=curves, record=head.record, roots=head.roots)
        scene = Scene(Gaussians(**columns), tree, ids, mode=head.mode, threshold=head.threshold)
        return replace(scene, tile_rule=head.tile_rule, source=head.source)


@dataclass(frozen=True, eq=False)
class _Places:
    """Where rows of the whole are."""

    nodes: Array  # the row of the crown that each is, or that stands for it
    shift: Array  # its row in the whole less its row in its file
    file: Array
    own: Array  # its row in its file

    def by_file(self) -> Iterator[tuple[int, Array, Array]]:
        """Each file that rows are in, which of the rows, and their rows there."""
        for number in np.unique(self.file):
            at = np.flatnonzero(self.file == number)
            yield int(number), at, self.own[at]


def _taken(stored: StoredScene, name: str, rows: Array) -> Array:
    """Rows of a column; no more of it is read than from the first to the last."""
    first = int(rows.min())
    column = stored.file.rows(name, first, int(rows.max()) + 1)
    return np.asarray(column[rows - first])


def _room(n: int, degree: int) -> dict[str, Array]:
    """Columns of `Gaussians` to be filled."""
    none = Gaussians.empty(degree)
    shapes = {f.name: getattr(none, f.name).shape[1:] for f in fields(Gaussians)}
    return {name: np.empty((n, *shape), np.float32) for name, shape in shapes.items()}


def open_whole(path: Path, *, checked: bool = True) -> WholeTree:
    """Open a folder to go through its whole tree.

    Args:
        path: the folder.
        checked: hold all files against their digests, for which all of them are read; without, their sizes and their trees.

    Raises:
        FormatError: a file is not the one that the manifest speaks of, or the files do not fit each other.
        InputError: there are 2³¹ rows or more.
    """
    manifest = read_manifest(path)
    if manifest.num_rows >= 2**31:
        raise InputError(f"{path}: found {manifest.num_rows} rows, wanted less than 2^31 in one scene")
    if not checked or not isinstance(path, ObjectPath):
        return _opened_whole(path, manifest, checked=checked)
    here = Brought(Path(mkdtemp(prefix="splatree-")))
    local = here.folder
    try:
        _bring(path, manifest, local)
        return replace(_opened_whole(local, manifest, checked=True), path=path, brought=here)
    except FormatError as error:
        raise FormatError(str(error).replace(str(local), str(path))) from error


def _bring(path: ObjectPath, manifest: Manifest, local: Path) -> None:
    """Copy the files of a folder to this machine: all of their bytes are needed, most of them twice."""
    named = (manifest.crown, *manifest.parts)
    with task(f"fetch {path.name}", float(sum(file.num_bytes for file in named))) as advance:
        for file in named:
            (local / file.name).parent.mkdir(parents=True, exist_ok=True)
            with (path / file.name).open("rb") as source, (local / file.name).open("wb") as target:
                copyfileobj(source, target, 1 << 20)
            advance(float(file.num_bytes))


def _opened_whole(path: Path, manifest: Manifest, *, checked: bool) -> WholeTree:
    named = (manifest.crown, *manifest.parts)
    with task(f"check {path.name}", float(sum(file.num_bytes for file in named))) as advance:
        opened = []
        for file in named:
            opened.append(_opened(path, file, checked=checked))
            advance(float(file.num_bytes))
    return _fitted(path, manifest, opened[0], opened[1:])


def _opened(path: Path, file: StoredFile, *, checked: bool) -> StoredScene:
    """A file whose bytes are those that the manifest speaks of, and whose rows are a tree."""
    stored = open_scene(checked_path(path, file) if checked else path / file.name)
    ends, depth, extents = (stored.file.rows(f"tree.{name}") for name in ("subtree_end", "depth", "extents"))
    try:
        GaussianTree(ends, depth, extents)
    except ShapeError as error:
        raise FormatError(f"{path / file.name}: {error}; the file is damaged") from error
    return stored


def _fitted(path: Path, manifest: Manifest, crown: StoredScene, parts: list[StoredScene]) -> WholeTree:
    where = path / manifest.crown.name
    ends = crown.file.rows("tree.subtree_end")
    leaves = np.flatnonzero(ends == np.arange(1, len(crown) + 1))
    if not crown.head.has_ids:
        raise FormatError(f"{where}: found no ids, wanted the numbers of the roots of all parts")
    numbers = crown.file.rows("ids")[leaves]
    copies = leaves[np.argsort(numbers, kind="stable")]
    if not np.array_equal(np.sort(numbers), np.arange(len(copies))):
        raise FormatError(f"{where}: found ids of leaves that are not 0 to {len(copies) - 1}")
    sizes = np.ones(len(crown), np.int64)
    file_of, row_of = np.zeros(len(crown), np.int32), np.arange(len(crown), dtype=np.int32)
    num_roots, num_leaves, largest_id = 0, 0, -1
    means = crown.file.rows("gaussians.means")
    for number, (part, file) in enumerate(zip(parts, manifest.parts, strict=True), start=1):
        part_ends = part.file.rows("tree.subtree_end")
        roots = np.flatnonzero(part.file.rows("tree.depth") == 0)
        if num_roots + len(roots) > len(copies):
            raise FormatError(
                f"{path / file.name}: found more roots than the {len(copies)} that the crown has copies of"
            )
        own = copies[num_roots : num_roots + len(roots)]
        num_roots += len(roots)
        is_alike = (part.head.sh_degree, part.head.has_curves) == (crown.head.sh_degree, crown.head.has_curves)
        if not is_alike or not np.array_equal(part.file.rows("gaussians.means")[roots], means[own]):
            raise FormatError(
                f"{path / file.name}: found roots that are not those of the crown; the file is of another build"
            )
        sizes[own], file_of[own], row_of[own] = part_ends[roots] - roots, number, roots
        is_leaf = part_ends == np.arange(1, len(part) + 1)
        ids = part.file.rows("ids")[is_leaf] if part.head.has_ids else np.flatnonzero(is_leaf)
        num_leaves, largest_id = num_leaves + len(ids), max(largest_id, int(ids.max(initial=0)))
    first_row = np.concatenate([[0], np.cumsum(sizes)])
    n = int(first_row[-1])
    if num_roots != len(copies) or n != manifest.num_rows:
        raise FormatError(
            f"{path / MANIFEST}: found {n} rows and {num_roots} roots in the files, wanted {manifest.num_rows} and "
            f"{len(copies)}"
        )
    if largest_id + 1 + n > 2**32:
        raise FormatError(f"{path}: found identities of leaves up to {largest_id}, which leave no room for nodes")
    head = replace(crown.head, num_rows=n, has_ids=True)
    return WholeTree(path, head, num_leaves, (crown, *parts), first_row, file_of, row_of, largest_id + 1)
