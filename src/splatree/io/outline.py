"""What describes a scene without holding all of it: every row without its harmonics, and a sample with them.

Harmonics are three quarters of a scene at degree 3. A file that can be read in chunks is gone through once, and they are left
behind: 56 bytes a Gaussian stay in memory, of 248 in a .ply. Of a folder of parts only the tree and the means are gone through,
and leaves that are evenly spread over it are read, 250,000 at most. So many leaves are kept of a file with levels, too, if its
columns would take more than half of the free memory. Other files are read whole.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from splatree.io.formats.folder.manifest import holds_parts
from splatree.io.formats.folder.whole import open_whole
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import StoredScene
from splatree.io.inputs import find_inputs
from splatree.io.joined import joined_source
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.memory import free_bytes
from splatree.io.notes import with_notes
from splatree.io.options import ReadOptions
from splatree.io.reading import read
from splatree.io.registry import detect
from splatree.io.runs import TreeRuns
from splatree.io.tree_runs import open_runs
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array

__all__ = ["Outline", "outline_of", "read_outline"]

SAMPLE: Final = 60_000
"""Rows with their harmonics, at least, of a scene that has so many: as many as framing looks at."""

FOLDER_SAMPLE: Final = 250_000
"""Leaves of a folder of parts that are looked at, at most: 14 MB; quantiles then err by 0.1 %."""

FOLDER_RUN: Final = 1 << 17
"""Rows of a folder that are gone through at once."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A scene, possibly without its harmonics."""

    scene: Scene
    """Every row; of degree 0 if the file went through in chunks. Of a folder of parts or a large file with levels, evenly spread
    leaves."""
    sample: Scene
    """Rows with all their columns, spread evenly over the file; the scene itself where it was read whole."""
    in_chunks: bool
    """Whether the file went through in chunks."""
    nodes_per_depth: tuple[int, ...]
    """Nodes of the scene at each depth, roots first."""
    num_leaves: int
    """Leaves of the scene."""

    box: tuple[Array, Array]
    """Least and largest coordinates of the leaves' means, world units; zeros if there are none."""

    @property
    def num_nodes(self) -> int:
        """Nodes of the scene."""
        return sum(self.nodes_per_depth)

    @property
    def nbytes(self) -> int:
        """Memory of all columns of the scene, harmonics included, bytes."""
        return _nbytes(self.num_nodes, self.sample.gaussians.sh_degree)


def _nbytes(num_nodes: int, sh_degree: int) -> int:
    return num_nodes * (11 * 4 + 12 * (sh_degree + 1) ** 2)


def outline_of(scene: Scene) -> Outline:
    """The outline of a scene in memory: the scene itself."""
    is_leaf, means = scene.tree.is_leaf, scene.gaussians.means
    return Outline(scene, scene, False, _per_depth(scene.tree.depth), int(is_leaf.sum()), _box_of([means[is_leaf]]))


def _box_of(runs: Iterable[Array]) -> tuple[Array, Array]:
    bounds = [(run.min(axis=0), run.max(axis=0)) for run in runs if len(run)] or [(np.zeros(3, np.float32),) * 2]
    return np.min([low for low, _ in bounds], axis=0), np.max([high for _, high in bounds], axis=0)


def _per_depth(depths: Array) -> tuple[int, ...]:
    return tuple(int(n) for n in np.bincount(depths))


def read_outline(paths: Sequence[Path], options: ReadOptions) -> Outline:
    """Read what describes a scene, in chunks wherever its formats allow that.

    Args:
        paths: files or folders, which are one scene, as `read` takes them.
        options: how they are read.

    Raises:
        FormatError: a file does not hold what it promises.
        InputError: nothing is there, it is of no known format, or the inputs cannot be joined.
    """
    with local_inputs(paths) as local:
        found = find_inputs(local.paths, lambda path: detect(path) is not None)
        outline = _of_tree(found.paths[0], options) if len(found.paths) == 1 else None
        outline = outline or _in_chunks(found.paths, options)
        if outline is None:
            outline = outline_of(
                read(
                    found.paths,
                    level=options.level,
                    repair=options.repair,
                    axes=options.axes,
                    ignore_properties=options.ignore_properties,
                )
            )
    source = outline.scene.source
    source = with_notes(replace(source, paths=tuple(map(local.named, source.paths))), found.notes)
    return replace(outline, scene=replace(outline.scene, source=source), sample=replace(outline.sample, source=source))


def _of_tree(path: Path, options: ReadOptions) -> Outline | None:
    """Of a folder of parts, or a file with levels that is large; None: of others."""
    if options.level is not None or options.repair:
        return None
    if holds_parts(path):
        return _of_folder(path)
    tree = open_runs(path)
    return _of_runs(tree) if tree is not None and 2 * _nbytes(len(tree), tree.head.sh_degree) > free_bytes() else None


def _of_runs(tree: TreeRuns) -> Outline:
    """As of a folder, but all rows are gone through."""
    step, num_before = -(-tree.num_leaves // FOLDER_SAMPLE) or 1, 0
    num_kept = -(-tree.num_leaves // step)
    every = -(-num_kept // SAMPLE) or 1
    per_depth, boxes = np.zeros(256, np.int64), []
    plain, sampled = [Gaussians.empty()], [Gaussians.empty(tree.head.sh_degree)]
    for run in tree.runs("read"):
        per_depth += np.bincount(run.depth, minlength=256)
        leaves = np.flatnonzero(run.subtree_end == np.arange(run.begin + 1, run.begin + len(run) + 1))
        means = run.gaussians.means[leaves]
        if len(leaves):
            boxes.append(np.stack([means.min(axis=0), means.max(axis=0)]))
        plain.append(run.gaussians.take(leaves[-num_before % step :: step]).with_sh_degree(0))
        sampled.append(run.gaussians.take(leaves[-num_before % (step * every) :: step * every]))
        num_before += len(leaves)
    scene, sample = (_as_scene(Gaussians.concatenate(parts), tree.head) for parts in (plain, sampled))
    return Outline(scene, sample, True, _nodes_of(per_depth), tree.num_leaves, _box_of(boxes))


def _as_scene(gaussians: Gaussians, head: SceneHead) -> Scene:
    """Leaves that are looked at, drawn as the tree is."""
    flat = Scene.flat(gaussians, mode=head.mode, source=head.source)
    flat = replace(flat, threshold=head.threshold, tile_rule=head.tile_rule)
    return replace(flat, tree=replace(flat.tree, record=head.record))


def _nodes_of(per_depth: Array) -> tuple[int, ...]:
    return tuple(int(n) for n in np.trim_zeros(per_depth, "b"))


def _of_folder(path: Path) -> Outline:
    tree = open_whole(path, checked=False)
    per_depth, leaves = np.zeros(256, np.int64), []
    step, num_before = -(-tree.num_leaves // FOLDER_SAMPLE) or 1, 0
    with task(f"read {path.name}", float(len(tree))) as advance:
        for begin in range(0, len(tree), FOLDER_RUN):
            ends, depth = tree.shape(begin, min(begin + FOLDER_RUN, len(tree)))
            per_depth += np.bincount(depth, minlength=256)
            rows = begin + np.flatnonzero(ends == begin + 1 + np.arange(len(ends)))
            leaves.append(rows[-num_before % step :: step].copy())
            num_before += len(rows)
            advance(float(len(ends)))
    rows = np.concatenate([np.zeros(0, np.int64), *leaves])
    few = rows[:: -(-len(rows) // SAMPLE) or 1]
    plain = _plain(len(rows))
    for begin in range(0, len(rows), FOLDER_RUN):
        _fill(plain, begin, tree.take(rows[begin : begin + FOLDER_RUN]))
    head = replace(tree.head, source=replace(tree.head.source, paths=(str(path),), format="splatree-folder"))
    scene, sample = (_as_scene(g, head) for g in (plain, tree.take(few)))
    box = _box_of(map(_leaf_means, tree.files[1:]))
    return Outline(scene, sample, True, _nodes_of(per_depth), tree.num_leaves, box)


def _leaf_means(part: StoredScene) -> Array:
    is_leaf = part.file.rows("tree.subtree_end") == np.arange(1, len(part) + 1)
    means: Array = part.file.rows("gaussians.means")[is_leaf]
    return means


def _plain(n: int) -> Gaussians:
    """Room for rows without harmonics."""
    return Gaussians(*(np.empty((n, *c.shape[1:]), c.dtype) for c in vars(Gaussians.empty()).values()))


def _fill(plain: Gaussians, row: int, chunk: Gaussians) -> None:
    for name, column in vars(chunk.with_sh_degree(0)).items():
        getattr(plain, name)[row : row + len(chunk)] = column


def _in_chunks(paths: Sequence[Path], options: ReadOptions) -> Outline | None:
    parts = opened_chunks(paths, options)
    if parts is None:
        return None
    chunks = joined_chunks(parts, paths)
    plain = _plain(len(chunks))
    samples, step, row = [Gaussians.empty(chunks.sh_degree)], -(-len(chunks) // SAMPLE) or 1, 0
    with task("read", len(chunks)) as advance:
        for chunk in chunks:
            _fill(plain, row, chunk)
            samples.append(chunk.take(np.arange(-row % step, len(chunk), step)))
            row += len(chunk)
            advance(len(chunk))
    named = [Source((str(path),), _format_name(path), part.metadata) for path, part in zip(paths, parts, strict=True)]
    joined = joined_source(named)
    source = Source(joined.paths, joined.format, _with_repairs(chunks.metadata, [part.repairs for part in parts]))
    source = replace(source, origin=chunks.origin)
    scene, sample = (Scene.flat(g, mode=chunks.mode, source=source) for g in (plain, Gaussians.concatenate(samples)))
    return Outline(scene, sample, True, _per_depth(scene.tree.depth), len(scene), _box_of([scene.gaussians.means]))


def _format_name(path: Path) -> str:
    found = detect(path)
    return "" if found is None else found.name


def _with_repairs(metadata: Mapping[str, str], repairs: Sequence[dict[str, int]]) -> dict[str, str]:
    """The metadata with what the pass over the rows had to repair."""
    counts: Counter[str] = Counter()
    for part in repairs:
        counts.update(part)
    return {**metadata, "repairs": json.dumps(counts)} if counts else dict(metadata)
