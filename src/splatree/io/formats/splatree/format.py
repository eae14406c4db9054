"""Native ``.splatree``: a safetensors file with one tensor a column of the scene and its other fields as JSON strings.

The file is an eight-byte length, a JSON header and the columns, each where the header says; so it is memory-mapped and no
byte is copied: a scene opens in the time of checking its values. Which columns there are follows from the fields of `Scene`
and of the structs in it: ``gaussians.means``, ``tree.depth``, ``ids`` and so on; a field that holds None is left out. The block
index is not kept: one from a stale or hostile file could hide rows without a trace, and making it anew costs 25 ns a row. For the
same reason the radii and boxes of clusters are written for others to read, but computed anew here, in 10 ns a row. The index of
pages of a large file is kept for who draws page by page (io/pages/), since making it anew reads the file; here it is passed over.

Any safetensors library reads the file, and no code is ever loaded from it. That library is not used here, because it copies
every tensor and builds the whole file in memory before it writes; in the tests it is the judge.
docs/reference/formats/splatree.md.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatree.errors import FormatError, InputError, ShapeError
from splatree.io.check import checked
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.splatree.container import SPARE_BYTES, Container, header_bytes, open_container, placed
from splatree.io.formats.splatree.fields import (
    NOT_STORED,
    PAGES,
    column_types,
    columns_of,
    source_from,
    struct_from,
    value_of,
    values_of,
)
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.older import record_of_provenance
from splatree.io.formats.splatree.rows import SceneRows, StoredScene, open_scene
from splatree.io.formats.splatree.writer import SceneWriter
from splatree.io.levels import check_extents
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.pages.index_file import append_index, wants_index
from splatree.io.runs import TreeRuns
from splatree.kernels.cpu.build.spheres import bound_clusters
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a safetensors file that says it is ours in its metadata, which we write first."""
    return head[8:].startswith(b'{"__metadata__":{"format":"splatree"')


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write every column and field; reading gives the same bits, unless the file shall be compact.

    Raises:
        InputError: a value cannot be written compact.
    """
    kept = replace(scene, blocks=None)
    if options.compact:
        from splatree.io.formats.splatree.compact import compacted, lost_by_it

        lost, (columns, values) = lost_by_it(scene), compacted(kept)
    else:
        lost, columns, values = (), dict(columns_of(kept, "")), dict(values_of(kept, ""))
    for name in NOT_STORED:
        values.pop(name, None)
    places = placed({name: (column.dtype, column.shape) for name, column in columns.items()})
    total = sum(place.num_bytes for place in places.values())
    is_indexed = not options.compact and wants_index(SceneHead.of(scene))
    with path.open("wb") as file, task(f"write {path.name}", total) as advance:
        file.write(header_bytes(values, places, spare=SPARE_BYTES * is_indexed))
        for name, place in places.items():
            if place.num_bytes:
                file.write(np.ascontiguousarray(columns[name]).reshape(-1).view(np.uint8).data)
            advance(place.num_bytes)
    if is_indexed:
        append_index(path)
    return lost


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write a flat scene chunk by chunk: the bytes that `write` writes of the scene, less the counts of repairs.

    Raises:
        InputError: the file shall be compact, for which the scene must be in memory.
    """
    if options.compact:
        raise InputError(
            "compact: found a scene in chunks, wanted one in memory; write it without, and convert the file"
        )
    with path.open("wb") as file, task(f"write {path.name}", len(chunks)) as advance:
        writer = SceneWriter(file, SceneHead(len(chunks), chunks.sh_degree, chunks.mode, source=chunks.source))
        for chunk in chunks:
            writer.append(Scene.flat(chunk, mode=chunks.mode))
            advance(len(chunk))
    return ()


def read_leaves(path: Path, options: ReadOptions) -> Chunks | None:
    """The leaves in chunks; None where values may be repaired, which trees do not bear."""
    if options.repair:
        return None
    if (file := open_container(path)).is_compact:
        return _compact_leaves(file, options)
    stored = open_scene(path)
    end = stored.file.rows("tree.subtree_end")
    num_leaves = sum(
        int((end[i : i + ROWS_PER_CHUNK] == np.arange(i + 1, min(i + ROWS_PER_CHUNK, len(end)) + 1)).sum())
        for i in range(0, len(end), ROWS_PER_CHUNK)
    )
    head, clusters = stored.head, stored.file.columns.get("clusters.centers")
    return Chunks(
        *(num_leaves, head.sh_degree, head.mode, lambda: leaves_of(stored, 0, len(stored)), head.source.metadata),
        origin=head.source.origin,
        threshold=head.threshold,
        num_merged=len(stored) - num_leaves,
        num_clusters=0 if clusters is None else clusters.shape[0],
    )


def read_runs(path: Path) -> TreeRuns | None:
    """The rows, without clusters; None for a compact file.

    Raises:
        FormatError: the rows are no tree.
    """
    if is_compact(path):
        return None
    stored = open_scene(path)
    ends, depth, extents = (stored.file.rows(f"tree.{name}") for name in ("subtree_end", "depth", "extents"))
    try:
        tree = GaussianTree(ends, depth, extents)
    except ShapeError as error:
        raise FormatError(f"{path}: {error}; the file is damaged") from error
    return TreeRuns(
        stored.head, tree.num_leaves, lambda what: _runs_of(stored, what), has_more=not has_rows_alone(stored)
    )


def has_rows_alone(stored: StoredScene) -> bool:
    """Whether a file has nothing but columns of rows, their index and the state of its roots, and no clusters."""
    head = stored.head
    known = column_types(len(stored), 1, has_ids=head.has_ids, has_curves=head.has_curves)
    return all(name in known or name == PAGES or name.startswith("tree.roots.") for name in stored.file.columns)


def _runs_of(stored: StoredScene, what: str) -> Iterator[SceneRows]:
    step = ROWS_PER_CHUNK * (8 if stored.file.is_elsewhere else 1)  # 30 MB at degree 3, by a request for each column
    with task(what, float(len(stored))) as advance:
        for begin in range(0, len(stored), step):
            end = min(begin + step, len(stored))
            yield stored.rows(begin, end)
            stored.forget(begin, end)
            advance(float(end - begin))


def _compact_leaves(file: Container, options: ReadOptions) -> Chunks:
    from splatree.io.formats.splatree.compact import leaves_alone

    where, found = str(file.path), leaves_alone(file)
    try:
        head = SceneHead(
            found.num_rows,
            found.rows.sh_degree,
            value_of(file.values, "mode", where),
            value_of(file.values, "threshold", where),
            source=source_from(file.values, "source", where),
        )
    except (InputError, TypeError) as error:
        raise FormatError(f"{where}: {error}") from error
    return replace(
        found.rows.chunks(options),
        mode=head.mode,
        metadata=head.source.metadata,
        origin=head.source.origin,
        threshold=head.threshold,
        num_merged=found.num_rows - found.rows.num_rows,
        num_clusters=found.num_clusters,
    )


def leaves_of(stored: StoredScene, first: int, last: int) -> Iterator[Gaussians]:
    """The leaves in a run of rows of a file, in chunks; no row stays in memory."""
    for begin in range(first, last, ROWS_PER_CHUNK):
        end = min(begin + ROWS_PER_CHUNK, last)
        rows = stored.rows(begin, end)
        leaves = np.flatnonzero(rows.subtree_end == np.arange(begin + 1, end + 1))
        if len(leaves):
            yield rows.gaussians.take(leaves)
        stored.forget(begin, end)


def is_compact(path: Path) -> bool:
    """Whether a file of this format is compact, by its header."""
    return open_container(path).is_compact


def read(path: Path, options: ReadOptions) -> Scene:
    """Map the columns into memory, read-only; those of a compact file are decoded."""
    where, file = str(path), open_container(path)
    values = file.values
    if file.is_compact:
        from splatree.io.formats.splatree.compact import uncompacted

        columns = uncompacted(file)
    else:
        columns = {name: file.rows(name) for name in file.columns if name != PAGES}
    known = set(columns)
    _add_bounds(columns)
    try:
        scene = struct_from(Scene, "", columns, values, where)
    except InputError as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{where}: {error}") from error
    if columns:
        raise FormatError(f"{where}: found unknown columns {sorted(columns)} beside {sorted(known - set(columns))}")
    if scene.tree.record is None and scene.tree.depth.any():
        record = record_of_provenance(scene.source.metadata.get("levels"))
        scene = replace(scene, tree=replace(scene.tree, record=record))
    check_extents(scene.tree.extents, where)
    scene = checked(scene, where, repair=options.repair)
    clusters = scene.clusters
    if clusters is None and scene.tree.num_leaves == len(scene):
        return scene
    if clusters is not None:
        clusters = bound_clusters(scene.gaussians, clusters.start, clusters.centers)
    return replace(scene, blocks=index_blocks(scene.gaussians, scene.tree), clusters=clusters)


def _add_bounds(columns: dict[str, Array]) -> None:
    """Radii and boxes of clusters that hold everything, where a file has none; they are computed anew anyway."""
    centers = columns.get("clusters.centers")
    if centers is not None:
        for name, bound in (("box_low", -np.inf), ("box_high", np.inf)):
            columns.setdefault(f"clusters.{name}", np.full(centers.shape, bound, np.float32))
        for name in ("radii", "mean_radii", "footprint_radii"):
            columns.setdefault(f"clusters.{name}", np.full(centers.shape[:1], np.inf, np.float32))
