"""Put a scene that is larger than memory into clusters: the file of `build_clusters` and `write`, byte for byte.

A flat scene goes in four passes over its rows, and K-means is that of memory, over all means:

1. the means that the Morton frame is found from;
2. means and row numbers are sorted along the curve; K-means puts them into clusters, which says where each row goes;
3. the rows are sorted by where they go;
4. they are written, and the spheres and boxes around them found: a bound of a cluster is the largest of the bounds of its runs.

A tree keeps its order: where its subtrees end says which rows are a cluster, and the rows are written as they come.

Memory: 56 bytes a row for K-means, 17 bytes a row of a tree; in mapped files where there is no room. What K-means holds for its
centres has to fit.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from splatree.clusters.build import ClusterOptions, Placed, chosen_number, middles, placed, subtree_runs, with_rules
from splatree.errors import InputError, OutputError
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows
from splatree.io.formats.splatree.writer import create_scene
from splatree.io.inputs import find_inputs
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.memory import Scratch
from splatree.io.notes import notes_in, sentences_in
from splatree.io.objects import located
from splatree.io.options import ReadOptions
from splatree.io.registry import detect, format_to_write, stored_bytes
from splatree.io.replacing import check_target
from splatree.io.runs import TreeRuns
from splatree.io.sorting import Sorter
from splatree.io.tree_runs import stored_runs
from splatree.kernels.cpu.build.spheres import bound_clusters
from splatree.maths.morton import frame_of_sample, morton_codes, morton_sample
from splatree.progress import task
from splatree.scene.arguments import checked
from splatree.scene.clusters import ClusterIndex
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.modes import check_mode_of_levels
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, Int32

__all__ = ["ClusteredFile", "cluster_file"]

SUM_BYTES, MOST_SUMS = 32, 64
"""What K-means holds for each centre in each chunk of points, and the chunks (kernels/cpu/build/kmeans.cpp)."""

CENTER_BYTES = 250
"""What it holds besides for each centre."""

DRAW_SHARE, DRAW_BYTES = 50, 8
"""Where more than one row of so many is drawn as a first centre, NumPy numbers all rows, with so many bytes each."""


@dataclass(frozen=True)
class ClusteredFile:
    """A scene that was put into clusters through files.

    Example:
        >>> done = st.cluster_file("city.ply", "clusters.splatree", 9, force=True)
        >>> done.num_clusters, done.num_rows
        (9, 253)
    """

    path: Path
    """The file."""
    num_gaussians: int
    """Gaussians, without merged nodes."""
    num_rows: int
    """Gaussians and merged nodes."""
    num_clusters: int
    """Clusters."""
    bytes: int
    """Size of the file."""
    lost: tuple[str, ...] = ()
    """What reading could not keep, a sentence each."""
    repairs: dict[str, int] = field(default_factory=dict)
    """Number of values or rows that each rule of repair changed."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""


@checked
def cluster_file(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    num_clusters: int | Literal["auto"] = "auto",
    options: ClusterOptions | None = None,
    *,
    reading: ReadOptions | None = None,
    mode: Mode | None = None,
    max_memory: str | None = None,
    force: bool = False,
) -> ClusteredFile:
    """Add clusters to a scene that is larger than memory, and write it as one ``.splatree``.

    The file is that of `build_clusters` and `write`, byte for byte, for any memory.

    Args:
        inputs: one path or several of one scene, of formats that are read in chunks: .ply, .spz, .splat, .sog, .ksplat, .glb, 3D
            Tiles; or one folder of parts or exact .splatree, whose levels are kept.
        output: the new file, a .splatree.
        num_clusters: as for `build_clusters`.
        options: how clusters are made; None: the defaults.
        reading: how the inputs are read.
        mode: how the scene is drawn, where the files do not say it; levels keep the mode that they were made for.
        max_memory: what may be taken, such as 4G; None: half of the free memory.
        force: replace the file if it exists.

    Returns:
        What was written.

    Raises:
        FormatError: an input does not hold what it promises.
        InputError: an input is not read in chunks, there are fewer rows than clusters, or K-means needs more memory for its
            centres than is allowed.
        OutputError: the output exists, or could not be written; an old file is then whole.

    Source:
        Jo 2024, §3; docs/explanation/clusters.md.

    Example:
        >>> _ = st.cluster_file("city.ply", "clusters.splatree", 9, force=True)
        >>> len(st.read("clusters.splatree").clusters)
        9
    """
    options, target = given(options, ClusterOptions, "cluster_file: options"), located(output)
    if format_to_write(target).name != "splatree":
        raise InputError(f"{target}: found a format without clusters, wanted a name that ends in .splatree")
    check_target(target)
    if target.exists() and not force:
        raise OutputError(f"{target}: exists already; choose another name or replace it with force")
    with _opened(inputs, reading or ReadOptions(), mode) as (tree, parts, notes):
        count = chosen_number(num_clusters, len(tree))
        scratch = Scratch.beside(target, max_memory)
        if tree.num_leaves < len(tree):
            num_made = _tree_into(tree, target, count, scratch, force)
        else:
            num_made = _flat_into(tree, target, count, options, scratch, force)
        repairs: Counter[str] = Counter()
        for part in parts:
            repairs.update(part.repairs)
        source = tree.head.source
        return ClusteredFile(
            path=target,
            num_gaussians=tree.num_leaves,
            num_rows=len(tree),
            num_clusters=num_made,
            bytes=stored_bytes(target),
            lost=sentences_in(source.metadata, "lost"),
            repairs=dict(repairs),
            notes=(*notes, *notes_in(source.metadata, source.origin)),
        )


@contextmanager
def _opened(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], reading: ReadOptions, mode: Mode | None
) -> Iterator[tuple[TreeRuns, Sequence[Chunks], tuple[str, ...]]]:
    """All inputs in runs of rows; those of them that are read in chunks, which count repairs; and notes."""
    with local_inputs(inputs) as local:
        found = find_inputs(local.paths, lambda path: detect(path) is not None)
        parts = opened_chunks(found.paths, reading) or ()
        tree = stored_runs(found.paths[0]) if len(found.paths) == 1 and not reading.repair else None
        if tree is None and not parts:
            named = ", ".join(local.named(str(path)) for path in found.paths)
            raise InputError(
                f"{named}: found a format that is not read in chunks, or a .splatree that is compact, to be repaired or one of "
                "several; convert it to .ply first, or to an exact .splatree to keep its levels"
            )
        tree = tree or _runs_of(joined_chunks(parts, found.paths))
        if tree.num_leaves < len(tree):
            check_mode_of_levels(mode, None if tree.head.record is None else tree.head.record.mode)
        yield tree if mode is None else replace(tree, head=replace(tree.head, mode=mode)), parts, found.notes


def _runs_of(chunks: Chunks) -> TreeRuns:
    """Gaussians in chunks as rows of a scene without levels."""

    def runs(what: str) -> Iterator[SceneRows]:
        begin = 0
        with task(what, float(len(chunks))) as advance:
            for chunk in chunks:
                tree = Scene.flat(chunk).tree
                yield SceneRows(begin, chunk, tree.subtree_end + np.int32(begin), tree.depth, tree.extents, None)
                begin += len(chunk)
                advance(float(len(chunk)))

    head = SceneHead(len(chunks), chunks.sh_degree, chunks.mode, chunks.threshold, source=chunks.source)
    return TreeRuns(head, len(chunks), runs)


def _tree_into(tree: TreeRuns, target: Path, count: int, scratch: Scratch, force: bool) -> int:
    n = len(tree)
    ends, depth = scratch.zeros((n,), np.int32), scratch.zeros((n,), np.uint8)
    means = scratch.zeros((n, 3), np.float32)
    for run in tree.runs("look at the tree"):
        rows = slice(run.begin, run.begin + len(run))
        ends[rows], depth[rows], means[rows] = run.subtree_end, run.depth, run.gaussians.means
    start = subtree_runs(ends, depth, 2 * n // count)
    centers = middles(means, start)
    head = replace(tree.head, source=with_rules(tree.head.source, len(centers), None))
    _write(target, head, tree.runs(f"write {target.name}"), start, centers, force)
    return len(centers)


def _flat_into(tree: TreeRuns, target: Path, count: int, options: ClusterOptions, scratch: Scratch, force: bool) -> int:
    _take_room_of_centers(scratch, count, len(tree))
    places, found = _places_of(tree, count, options, replace(scratch))
    types = _types(tree.head)
    width = sum(kind.itemsize * int(np.prod(shape)) for kind, shape in types)
    sample = np.linspace(0, len(tree), 1 << 12, dtype=np.uint64)
    with Sorter(len(tree), width, sample, _without(scratch, places)) as sorter:
        for run in tree.runs("sort into clusters"):
            sorter.put(places[run.begin : run.begin + len(run)].astype(np.uint64), _records(run, types))
        del places

        def runs() -> Iterator[SceneRows]:
            begin = 0
            with task(f"write {target.name}", float(len(tree))) as advance:
                for _, records in sorter.runs(ROWS_PER_CHUNK):
                    yield _rows(begin, records, types)
                    begin += len(records)
                    advance(float(len(records)))

        source = with_rules(tree.head.source, len(found.centers), options)
        head = replace(tree.head, source=source, has_ids=True, roots=None)
        _write(target, head, runs(), found.start, found.centers, force)
    return len(found.centers)


def _take_room_of_centers(scratch: Scratch, count: int, num_rows: int) -> None:
    """Set aside what K-means needs for its centres, which cannot lie in files."""
    needed = count * (SUM_BYTES * min(MOST_SUMS, num_rows // count + 1) + CENTER_BYTES)
    needed += DRAW_BYTES * num_rows if count > num_rows // DRAW_SHARE else 0
    if needed > scratch.room:
        raise InputError(
            f"clusters: found {count} clusters of {num_rows} Gaussians, for whose centres about {needed // 10**6} MB are needed "
            f"beside the program, wanted at most {scratch.room / 1e6:.0f} MB; raise --max-memory, or ask for fewer clusters"
        )
    scratch.room -= needed


def _without(scratch: Scratch, array: Array) -> Scratch:
    """The room beside an array, if that lies in memory."""
    return replace(scratch, room=max(0, scratch.room - array.nbytes))


def _places_of(
    tree: TreeRuns, count: int, options: ClusterOptions, scratch: Scratch
) -> tuple[Int32[Array, "n"], Placed]:
    """The new row of each row, and the clusters."""
    n = len(tree)
    along, means = scratch.zeros((n,), np.uint32), scratch.zeros((n, 3), np.float32)
    sizes = scratch.zeros((n,), np.float32) if options.size_classes else None
    width = 16 + 4 * options.size_classes
    step, sample = morton_sample(n).step, []
    for run in tree.runs("look at the scene"):
        sample.append(run.gaussians.means[-run.begin % step :: step].copy())
    frame = frame_of_sample(np.concatenate(sample))
    with Sorter(n, width, morton_codes(np.concatenate(sample), frame), replace(scratch)) as sorter:
        for run in tree.runs("sort along a curve"):
            g, rows = run.gaussians, np.arange(run.begin, run.begin + len(run), dtype=np.uint32)
            columns = [g.means.view(np.uint32), rows[:, None]]
            if options.size_classes:
                columns.append(g.log_scales.max(axis=1).view(np.uint32)[:, None])
            sorter.put(
                morton_codes(g.means, frame), np.ascontiguousarray(np.concatenate(columns, axis=1)).view(np.uint8)
            )
        begin = 0
        for _, records in sorter.runs(ROWS_PER_CHUNK):
            values, part = np.ascontiguousarray(records).view(np.uint32), slice(begin, begin + len(records))
            means[part], along[part] = values[:, :3].copy().view(np.float32), values[:, 3]
            if sizes is not None:
                sizes[part] = values[:, 4].copy().view(np.float32)
            begin += len(records)
    found = placed(means, sizes, count, options, zeros=scratch.zeros)
    places = scratch.zeros((n,), np.int32)
    for begin in range(0, n, 1 << 20):
        part = slice(begin, begin + (1 << 20))
        places[along[part]] = found.places[part]
    return places, replace(found, places=np.empty(0, np.int32))


Types = list[tuple["np.dtype[Any]", tuple[int, ...]]]
"""Type and shape of a row of each column."""


def _types(head: SceneHead) -> Types:
    """Of the Gaussians, the extents, the ids and the curves, in this order."""
    floats = np.dtype(np.float32)
    shapes = [column.shape[1:] for column in vars(Gaussians.empty(head.sh_degree)).values()]
    curves: Types = [(floats, (4,))] if head.has_curves else []
    return [*((floats, shape) for shape in [*shapes, ()]), (np.dtype(np.uint32), ()), *curves]


def _records(run: SceneRows, types: Types) -> Array:
    """Each row as bytes."""
    ids = np.arange(run.begin, run.begin + len(run), dtype=np.uint32) if run.ids is None else run.ids
    columns = [*(getattr(run.gaussians, f.name) for f in fields(Gaussians)), run.extents, ids]
    columns += [] if run.curves is None else [run.curves]
    kept = [
        np.ascontiguousarray(column, kind).reshape(len(run), -1)
        for column, (kind, _) in zip(columns, types, strict=True)
    ]
    return np.concatenate([column.view(np.uint8) for column in kept], axis=1)


def _rows(begin: int, records: Array, types: Types) -> SceneRows:
    """What `_records` made, as rows of a scene without levels."""
    columns, first, n = list[Array](), 0, len(records)
    for kind, shape in types:
        last = first + kind.itemsize * int(np.prod(shape))
        columns.append(np.ascontiguousarray(records[:, first:last]).view(kind).reshape(n, *shape))
        first = last
    num = len(fields(Gaussians))
    ends = np.arange(begin + 1, begin + n + 1, dtype=np.int32)
    extents, ids, *curves = columns[num:]
    gaussians = Gaussians(*columns[:num])
    return SceneRows(begin, gaussians, ends, np.zeros(n, np.uint8), extents, ids, curves[0] if curves else None)


def _write(
    target: Path,
    head: SceneHead,
    runs: Iterator[SceneRows],
    start: Int32[Array, "c+1"],
    centers: Float32[Array, "c 3"],
    force: bool,
) -> None:
    """Write rows, and the clusters with bounds that are found on the way."""
    radii = [np.zeros(len(centers), np.float32) for _ in range(3)]
    boxes = [np.full((len(centers), 3), bound, np.float32) for bound in (np.inf, -np.inf)]
    with create_scene(target, head, num_clusters=len(centers), force=force) as writer:
        for run in runs:
            writer.append(run)
            first, last = run.begin, run.begin + len(run)
            # The clusters that have rows in this run, and where they begin in it.
            own = slice(int(np.searchsorted(start, first, side="right")) - 1, int(np.searchsorted(start, last)))
            begins = (np.clip(start[own.start : own.stop + 1], first, last) - first).astype(np.int32)
            found = bound_clusters(run.gaussians, begins, centers[own])
            for largest, name in zip(radii, ("radii", "mean_radii", "footprint_radii"), strict=True):
                np.maximum(largest[own], getattr(found, name), out=largest[own])
            np.minimum(boxes[0][own], found.box_low, out=boxes[0][own])
            np.maximum(boxes[1][own], found.box_high, out=boxes[1][own])
        writer.append_clusters(ClusterIndex(start, centers, *radii, *boxes))
