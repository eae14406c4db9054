"""Levels by a radius that follow the pixel they are drawn at, above parts: with the bits of a build in memory.

What a node shows at the pixel that it is stored for is a sum over all of its leaves (lod/follow.py). That pixel follows from the
node's extent, so it is known only when the node is. A part holds all leaves below its nodes, and is fitted by itself. The crown
is fitted when it is whole:

1. All leaves pass by in the order of the tree, and are added to the sums of the nodes above them.
2. The moments of its nodes add up from those of the roots of parts.
3. The nodes become what moments and sums say. Copies of roots become what the roots are in their parts.

Sums run in the order in which they run in memory. The crown is gone through in pieces of whole subtrees, and then what lies above
the pieces, where their roots are leaves. So leaves pass by once, or twice where there is more than one piece.

Memory: 24 bytes a row of the crown, and a piece. Columns lie in a file.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatree.io.chunks import ROWS_PER_CHUNK
from splatree.io.formats.splatree.rows import SceneRows, StoredScene, open_scene
from splatree.kernels.cpu.build.curves import MOMENTS, add_shown, fit_curves_above, root_moments
from splatree.lod.follow import STORED_SHARE, dilations_of_extents, least_dilation
from splatree.maths.forests import depth_from_ends
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, new_array, read_array
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int64

__all__ = ["SHAPE", "known_of_roots", "seen_of", "with_followed_nodes"]

PIECE_ROWS = 1 << 19
"""Rows of the crown that are fitted together: 200 bytes each."""

PASS_LEAVES = 1 << 18
"""Leaves that pass by at a time, or those below one root."""

SHAPE = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": ()}
"""What of a node follows, beside its curve."""


def seen_of(work: Work, plan: Plan, inputs: Int64[Array, "n"]) -> Float32[Array, "n"]:
    """What others leave to be seen of rows of the input; 1 where nothing hides anything."""
    return np.ones(len(inputs), np.float32) if plan.sight is None else np.asarray(read_array(work.seen)[inputs])


def known_of_roots(gaussians: Gaussians, tree: GaussianTree, seen: Float32[Array, "n"], threads: int) -> Array:
    """What the crown has to know of each root of a part (r 13): the moments of its leaves.

    Args:
        gaussians: the rows of the part, following.
        tree: its tree.
        seen: visibilities of its rows; those of leaves count.
        threads: threads to use; 0: all.
    """
    num_roots = int((tree.depth == 0).sum())
    return root_moments(gaussians, tree.subtree_end, num_roots, seen=seen, threads=threads)


def with_followed_nodes(
    work: Work, plan: Plan, num_roots: Sequence[int], crown: StoredScene, threads: int = 0
) -> Iterator[SceneRows]:
    """The rows of the crown, following the pixel that they are drawn at.

    Args:
        work: where the parts with the leaves are.
        plan: theirs.
        num_roots: how many roots the part of each cell has.
        crown: the tree above them, as it was merged.
        threads: threads to use; 0: all.
    """
    path = work.folder / "followed.bin"
    try:
        above = _Above(work, plan, num_roots, crown, path)
        pieces, is_above = list(_pieces(above.ends)), np.ones(len(crown), bool)
        with task("let nodes follow the pixel", float(plan.num_rows)) as advance:
            known = [np.empty((0, MOMENTS))]
            for begin, end in pieces:
                is_above[begin:end] = False
                rows = np.arange(begin, end)
                known.append(above.fit(rows, above.known_of_copies(rows), threads))
                advance(float(above.first_leaf[end] - above.first_leaf[begin]))
            if is_above.any():
                roots = [row for piece in pieces for row in _roots_in(above.ends, *piece)]
                above.fit(np.union1d(np.flatnonzero(is_above), roots), np.concatenate(known), threads)
        yield from above.rows()
    finally:
        path.unlink(missing_ok=True)


def _pieces(ends: Array) -> Iterator[tuple[int, int]]:
    """Runs of whole subtrees that are not too large; rows between them are above some of them."""
    begin = row = 0
    while row < len(ends):
        is_small = ends[row] - row <= PIECE_ROWS
        if begin < row and not (is_small and ends[row] - begin <= PIECE_ROWS):
            yield begin, row
            begin = row
        row = int(ends[row]) if is_small else row + 1
        if not is_small:
            begin = row
    if begin < row:
        yield begin, row


def _roots_in(ends: Array, begin: int, end: int) -> Iterator[int]:
    while begin < end:
        yield begin
        begin = int(ends[begin])


class _Above:
    """The crown while it is fitted."""

    def __init__(self, work: Work, plan: Plan, num_roots: Sequence[int], crown: StoredScene, path: Path) -> None:
        n = len(crown)
        self._work, self._plan, self._crown = work, plan, crown
        self._stored = plan.resolved.stored_size
        self.ends = crown.file.rows("tree.subtree_end")
        """One past the last row of the subtree of each row."""
        self._copies = np.flatnonzero(self.ends == np.arange(1, n + 1))
        numbers, first_roots = crown.file.rows("ids")[self._copies].astype(np.int64), np.cumsum([0, *num_roots])
        self._file = (np.searchsorted(first_roots, numbers, side="right") - 1).astype(np.int32)
        self._number = (numbers - first_roots[self._file]).astype(np.int32)  # among the roots of its part
        self._row = np.empty(len(numbers), np.int32)  # of its part
        types = [(name, "<f4", shape) for name, shape in SHAPE.items()] + [("curves", "<f4", 4), ("extents", "<f4")]
        self._columns = new_array(path, n, np.dtype(types))
        self._columns["extents"] = crown.file.rows("tree.extents")
        num_leaves = np.zeros(n, np.int64)
        for file in np.unique(self._file):
            of_file = self._file == file
            num_leaves[self._copies[of_file]] = self._copied(int(file), of_file)
        self.first_leaf = np.concatenate([[0], np.cumsum(num_leaves)])
        """How many leaves of the whole tree lie before each row."""

    def _part(self, file: int) -> StoredScene:
        return open_scene(self._work.scene / self._work.part_name(file))

    def _copied(self, file: int, of_file: Array) -> Array:
        """Copy the roots of a part as they are drawn; returns how many leaves each has."""
        part, own, at = self._part(file).file, self._number[of_file], self._copies[of_file]
        ends = part.rows("tree.subtree_end")
        self._row[of_file] = rows = np.flatnonzero(part.rows("tree.depth") == 0)[own]
        for name in SHAPE:
            self._columns[name][at] = part.rows(f"gaussians.{name}")[rows]
        for name in ("curves", "extents"):
            self._columns[name][at] = part.rows(f"tree.{name}")[rows]
        leaves_before = np.concatenate([[0], np.cumsum(ends == np.arange(1, len(ends) + 1))])
        return np.asarray(leaves_before[ends[rows]] - leaves_before[rows])

    def known_of_copies(self, rows: Array) -> Array:
        """What `known_of_roots` said of the roots that the copies among rows stand for."""
        first, last = np.searchsorted(self._copies, (rows[0], rows[-1] + 1))
        files, own = self._file[first:last], self._number[first:last]
        known = np.empty((len(own), MOMENTS))
        for file in np.unique(files):
            known[files == file] = read_array(self._work.above.shown(int(file)))[own[files == file]]
        return known

    def fit(self, rows: Array, known: Array, threads: int) -> Array:
        """Fit the nodes among rows that are a forest, given what is known of its leaves; returns what is known of its roots."""
        ends = np.searchsorted(rows, self.ends[rows]).astype(np.int32)
        is_node, depth = ends > np.arange(1, len(rows) + 1), depth_from_ends(ends)
        nodes, here = rows[is_node], self._columns[rows]
        columns = {name: np.ascontiguousarray(here[name]) for name in SHAPE}
        gaussians = Gaussians(**columns, sh=np.zeros((len(rows), 1, 3), np.float32))
        extents = np.ascontiguousarray(here["extents"])
        dilations = dilations_of_extents(extents[is_node], self._stored)
        sums, spans = np.zeros((len(nodes), 2)), (self.first_leaf[nodes], self.first_leaf[self.ends[nodes]])
        for first, (log_scales, logits, seen) in self._leaves(int(rows[0]), int(self.ends[rows].max())):
            add_shown(log_scales, logits, seen, first, spans, dilations, sums, threads=threads)
        least = least_dilation(self._stored)
        gaussians, curves = fit_curves_above(
            *(gaussians, ends, known, STORED_SHARE, extents, sums), least_dilation=least, threads=threads
        )
        for name in SHAPE:
            here[name] = getattr(gaussians, name)
        here["curves"] = curves
        self._columns[nodes] = here[is_node]
        return root_moments(gaussians, ends, int((depth == 0).sum()), below=known, threads=threads)

    def _leaves(self, begin: int, end: int) -> Iterator[tuple[int, tuple[Array, Array, Array]]]:
        """The leaves of the whole tree below rows: the number of the first, their log-scales, logits and visibilities."""
        first, last = np.searchsorted(self._copies, (begin, end))
        bounds = self.first_leaf[[*self._copies[first:last], end]]
        at = 0
        while at < last - first:
            stop = max(at + 1, int(np.searchsorted(bounds, bounds[at] + PASS_LEAVES, side="right")) - 1)
            yield int(bounds[at]), self._leaves_of(slice(first + at, first + stop), bounds[at : stop + 1] - bounds[at])
            at = stop

    def _leaves_of(self, copies: slice, bounds: Array) -> tuple[Array, Array, Array]:
        """The leaves of some copies, the copy i from ``bounds[i]`` on."""
        files, rows = self._file[copies], self._row[copies]
        log_scales, logits = np.empty((bounds[-1], 3), np.float32), np.empty(bounds[-1], np.float32)
        inputs = np.empty(bounds[-1], np.int64)
        for file in np.unique(files):
            of_file = np.flatnonzero(files == file)
            part = self._part(int(file)).file
            ends = part.rows("tree.subtree_end")
            below = _ranges(rows[of_file], ends[rows[of_file]] - rows[of_file])
            leaves = below[ends[below] == below + 1]
            places = _ranges(bounds[of_file], bounds[of_file + 1] - bounds[of_file])
            log_scales[places] = part.rows("gaussians.log_scales")[leaves]
            logits[places] = part.rows("gaussians.logit_opacities")[leaves]
            inputs[places] = part.rows("ids")[leaves]
        return log_scales, logits, seen_of(self._work, self._plan, inputs)

    def rows(self) -> Iterator[SceneRows]:
        """All rows as they are drawn."""
        for begin in range(0, len(self._crown), ROWS_PER_CHUNK):
            merged = self._crown.rows(begin, min(begin + ROWS_PER_CHUNK, len(self._crown)))
            here = self._columns[begin : begin + len(merged)]
            gaussians = replace(merged.gaussians, **{name: np.ascontiguousarray(here[name]) for name in SHAPE})
            curves, extents = (np.ascontiguousarray(here[name]) for name in ("curves", "extents"))
            yield replace(merged, gaussians=gaussians, curves=curves, extents=extents)


def _ranges(first: Array, count: Array) -> Int64[Array, "n"]:
    """first[0], first[0] + 1, … (count[0] of them), first[1], …"""
    before = np.cumsum(count, dtype=np.int64) - count
    return np.asarray(np.repeat(first - before, count) + np.arange(count.sum()))
