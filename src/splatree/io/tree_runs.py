"""A tree in runs of rows, moved, cropped and cleaned with its levels: what is larger than memory.

A merged node stays if all leaves below it stay (edit/rows.py). A pass over the rows counts the leaves that are dropped before
each row; a node stays if as many are dropped before the end of its subtree as before itself. What is written are the bytes of the
same edit in memory.

Memory: 12 bytes a row where leaves are dropped, in a file where there is no room for them.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatree.edit.similarity import Similarity
from splatree.io.check import refuse_unusable
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.splatree.rows import SceneRows
from splatree.io.formats.splatree.writer import create_scene
from splatree.io.memory import Scratch
from splatree.io.registry import detect
from splatree.io.runs import TreeRuns
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import has_extents_of_levels
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool

__all__ = [
    "cut_chunks",
    "kept_runs",
    "moved_runs",
    "open_runs",
    "stored_runs",
    "write_runs",
]


def stored_runs(path: Path) -> TreeRuns | None:
    """The rows of a file or folder with levels, without its clusters; None: they are not read in runs.

    Raises:
        FormatError: the rows are no tree, or a file is damaged.
    """
    found = detect(path)
    tree = None if found is None or found.read_runs is None else found.read_runs(path)
    if found is None or tree is None:
        return None
    source = replace(tree.head.source, paths=(str(path),), format=found.name)
    return replace(tree, head=replace(tree.head, source=source))


def open_runs(path: Path) -> TreeRuns | None:
    """As `stored_runs`; None too for what has no levels, or has clusters."""
    tree = stored_runs(path)
    return None if tree is None or tree.has_more or tree.num_leaves == len(tree) else tree


def kept_runs(tree: TreeRuns, drops: Callable[[Gaussians], Bool[Array, "n"]], scratch: Scratch) -> TreeRuns:
    """The tree without the leaves that ``drops`` marks, and without all nodes above one of them; as `keep_leaves`."""
    n, num_dropped = len(tree), 0
    ends, dropped_before = scratch.zeros((n,), np.int32), scratch.zeros((n + 1,), np.int32)
    for run in tree.runs("look at the tree"):
        first, last = run.begin, run.begin + len(run)
        is_leaf = run.subtree_end == np.arange(first + 1, last + 1)
        ends[first:last] = run.subtree_end
        dropped_before[first + 1 : last + 1] = num_dropped + np.cumsum(is_leaf & drops(run.gaussians))
        num_dropped = int(dropped_before[last])
    if num_dropped == 0:
        return tree
    new_row = scratch.zeros((n + 1,), np.int32)
    for first in range(0, n, ROWS_PER_CHUNK):
        last = min(first + ROWS_PER_CHUNK, n)
        stays = dropped_before[ends[first:last]] == dropped_before[first:last]
        new_row[first + 1 : last + 1] = new_row[first] + np.cumsum(stays)

    def runs(what: str) -> Iterator[SceneRows]:
        covered, top = 0, 0  # where the subtree of the last new root ends, and the depth that this root had
        for run in tree.runs(what):
            first = run.begin
            kept = np.flatnonzero(np.diff(new_row[first : first + len(run) + 1]))
            if len(kept) == 0:
                continue
            stops, depth = run.subtree_end[kept], run.depth[kept]
            reached = np.maximum.accumulate(np.append(covered, stops))
            roots = np.where(kept + first >= reached[:-1], np.arange(len(kept)), -1)
            last_root = np.maximum.accumulate(roots)
            tops = np.where(last_root < 0, top, depth[last_root])
            covered, top = int(reached[-1]), int(tops[-1])
            yield SceneRows(
                begin=int(new_row[first]),
                gaussians=run.gaussians.take(kept),
                subtree_end=new_row[stops],
                depth=(depth - tops).astype(np.uint8),
                extents=run.extents[kept],
                ids=None if run.ids is None else run.ids[kept],
                curves=None if run.curves is None else run.curves[kept],
            )

    return TreeRuns(replace(tree.head, num_rows=int(new_row[n]), roots=None), tree.num_leaves - num_dropped, runs)


def moved_runs(tree: TreeRuns, similarity: Similarity, sh_degree: int) -> TreeRuns:
    """The tree moved, and with harmonics up to a degree, which it has; as `edit`."""
    if similarity.is_identity and sh_degree == tree.head.sh_degree:
        return tree
    is_flat, reach = tree.num_leaves == len(tree), np.float32(0)
    for run in () if is_flat else tree.runs("look how far the tree reaches"):
        reach = np.maximum(reach, similarity.reach(similarity.moved(run.gaussians)))

    def runs(what: str) -> Iterator[SceneRows]:
        for run in tree.runs(what):
            gaussians = run.gaussians.with_sh_degree(sh_degree)
            if not similarity.is_identity:
                gaussians = similarity.gaussians(gaussians)
                refuse_unusable(gaussians, "the scene after the edits", first_row=run.begin)
            is_leaf = run.subtree_end == np.arange(run.begin + 1, run.begin + len(run) + 1)
            is_level = ~is_leaf & has_extents_of_levels(tree.head.record)
            extents = (
                Scene.flat(gaussians).tree.extents if is_flat else similarity.extents(run.extents, reach, is_level)
            )
            yield replace(run, gaussians=gaussians, extents=extents, curves=similarity.curves(run.curves))

    record = None if tree.head.record is None else tree.head.record.scaled(similarity.scale)
    return TreeRuns(replace(tree.head, sh_degree=sh_degree, record=record, roots=None), tree.num_leaves, runs)


def cut_chunks(tree: TreeRuns, depth: int) -> Chunks:
    """The nodes at a depth and the leaves above it, as a flat scene in chunks; as `cut_at`."""

    def drawn(run: SceneRows) -> Bool[Array, "n"]:
        is_leaf = run.subtree_end == np.arange(run.begin + 1, run.begin + len(run) + 1)
        return np.asarray((run.depth == depth) | (is_leaf & (run.depth < depth)))

    def make() -> Iterator[Gaussians]:
        return (run.gaussians.take(drawn(run)) for run in tree.runs("go through the tree"))

    head, count = tree.head, sum(int(drawn(run).sum()) for run in tree.runs("count the nodes of the cut"))
    source = head.source
    return Chunks(
        *(count, head.sh_degree, head.mode, make, source.metadata),
        origin=source.origin,
        paths=source.paths,
        format=source.format,
        threshold=head.threshold,
    )


def write_runs(tree: TreeRuns, target: Path, *, force: bool) -> None:
    """Write the tree as one ``.splatree``.

    Raises:
        OutputError: the file exists, or could not be written.
    """
    with create_scene(target, tree.head, force=force) as writer:
        for run in tree.runs(f"write {target.name}"):
            writer.append(run)
