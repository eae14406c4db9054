"""The fourth pass: the levels of one cell.

By a radius, a cell is loaded with as much around it as growing needs, seven times the radii together; where that is too little,
half as much more, and again. Nothing is decided otherwise. By pairs, what is around a cell stays as it is: who would be merged
with it waits, and is merged where it meets its neighbours, by the levels above.

What the cell owns is written as a part. Its roots are written again by themselves, as a cell of the work on the levels above,
which goes the same way: cells of roots are grown to parts, whose leaves are copies of these roots. Where all roots fit in memory
together, they are one cell, and its part is the crown.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from splatree.io.formats.folder.manifest import stored_file
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.formats.splatree.writer import write_plain
from splatree.lod.assemble import assemble, order_of
from splatree.lod.forest import Forest, forest_above, forest_of_leaves
from splatree.lod.grow import grow
from splatree.lod.grow_pairs import grow_by_pairs, grow_part_by_pairs
from splatree.lod.grow_region import Owned, TooNarrowError, grow_region
from splatree.lod.region import EVERYWHERE, Region
from splatree.lod.shown import NODES_AT_A_TIME, Shown, fit_shown, num_columns, shown_above, shown_of_leaves
from splatree.outofcore.follow import SHAPE, known_of_roots, seen_of
from splatree.outofcore.load import Loaded, harmonics, load, reaches
from splatree.outofcore.plan import Plan
from splatree.outofcore.shuffle import write_bounds
from splatree.outofcore.work import Work, new_array, read_array, write_array
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array

__all__ = ["grow_cell", "grow_cell_by_pairs", "grow_crown"]


AROUND = 24.0
"""Levels by pairs: how far around a cell is loaded, in pixels p_0: eight median Gaussians. Who looks farther waits."""

FEWEST_SHARE = 16
"""Levels by pairs: a cell grows until one in so many of its rows is left, or waits at the border."""


def grow_cell(work: Work, plan: Plan, number: int, num_levels: int, threads: int = 0) -> dict[str, Any]:
    """Grow a cell by a radius and write its part; returns what the manifest and the report have to know."""
    owned, loaded = _grown(work, plan, number, num_levels, threads)
    sizes = plan.resolved.sizes_from(plan.num_sizes, num_levels)
    result = {"counts": owned.counts, "merged": _merged(sizes, owned.counts), "loaded": len(loaded.inputs)}
    seen = seen_of(work, plan, loaded.inputs[owned.rows]) if plan.first_roots is None else None
    return result | _write_part(work, plan, number, owned.forest, loaded, owned.rows, seen, threads)


def grow_cell_by_pairs(work: Work, plan: Plan, number: int, num_levels: int, threads: int = 0) -> dict[str, Any]:
    """Grow a cell by pairs and write its part: as `grow_cell`, where what is around it stays as it is.

    Args:
        work: where the pieces are.
        plan: what was decided for the whole scene.
        number: of the cell.
        num_levels: sizes to go through; 0: until a sixteenth of the rows is left, or to the end if this is the only cell.
        threads: threads to use; 0: all.
    """
    region = Region(plan.cells.boxes[number], AROUND * plan.resolved.judged_size)
    both = load(work, plan, number, region.reach)
    loaded, around = (both.take(np.flatnonzero(side)) for side in (both.cells == number, both.cells != number))
    leaves, others = (_leaves_of(work, plan, part, threads) for part in (loaded, around))
    rows = leaves.base.order
    forest = replace(leaves, base=replace(leaves.base, order=np.arange(len(rows), dtype=np.int32)))
    levels = num_levels or None
    if region.box == EVERYWHERE:
        forest = grow_by_pairs(forest, plan.resolved, num_levels=levels, threads=threads)
    else:
        fewest = 1 if num_levels else len(rows) // FEWEST_SHARE
        forest = grow_part_by_pairs(
            forest, plan.resolved, region, others, num_levels=levels, fewest=fewest, threads=threads
        )
    waiting = 0 if forest.grown is None else int((forest.grown < forest.num_sizes).sum())
    result: dict[str, Any] = {"merged": _merged(forest.sizes, forest.counts), "waiting": waiting}
    return result | _write_part(work, plan, number, forest, loaded, rows, leaves.visibilities, threads)


def _leaves_of(work: Work, plan: Plan, loaded: Loaded, threads: int) -> Forest:
    """Leaves by pairs, with what was measured of them in the whole scene."""
    scene, seen = Scene.flat(loaded.gaussians, mode=plan.mode), seen_of(work, plan, loaded.inputs)
    return forest_of_leaves(scene, plan.resolved, inputs=loaded.inputs, visibilities=seen, threads=threads)


def grow_crown(work: Work, plan: Plan, number: int, argument: float = 0, threads: int = 0) -> dict[str, Any]:
    """Grow all roots of parts together, to the end, and write them as one part: as `grow_cell`, without an argument."""
    loaded = load(work, plan, number, np.inf)
    forest = _forest_of(work, plan, loaded, threads)
    rows = forest.base.order
    forest = replace(forest, base=replace(forest.base, order=np.arange(len(rows), dtype=np.int32)))
    forest = grow(forest, plan.resolved, threads=threads)
    result: dict[str, Any] = {"merged": _merged(forest.sizes, forest.counts)}
    return result | _write_part(work, plan, number, forest, loaded, rows, None, threads)


def _merged(sizes: Iterable[float], counts: Sequence[int]) -> list[tuple[float, int]]:
    """How many nodes fewer there are after each size."""
    return [(size, before - left) for size, (before, left) in zip(sizes, pairwise(counts), strict=True)]


def _forest_of(work: Work, plan: Plan, loaded: Loaded, threads: int) -> Forest:
    """What grows, with the levels that it has."""
    if loaded.roots is not None:
        return forest_above(loaded.gaussians, loaded.roots, plan.resolved)
    scene = Scene.flat(loaded.gaussians, mode=plan.mode)
    seen = seen_of(work, plan, loaded.inputs) if plan.resolved.visibility else None
    leaves = forest_of_leaves(scene, plan.resolved, inputs=loaded.inputs, visibilities=seen, threads=threads)
    return replace(leaves, num_sizes=plan.num_sizes)  # more than none where a cell of roots is empty


def _write_part(
    work: Work, plan: Plan, number: int, forest: Forest, loaded: Loaded, rows: Array, seen: Array | None, threads: int
) -> dict[str, Any]:
    """Write a part and its roots; ``seen`` of parts whose leaves are those of the scene."""
    by_pairs, follows = plan.resolved.method == "pairs", plan.follows
    if not by_pairs and plan.first_roots is not None:
        follows = False  # until the crown is whole
    if not len(rows):
        write_bounds(work.above, number, np.empty((0, 3)))
        return {"leaves": 0, "rows": 0, "roots": 0, "depth": 0, "file": None}
    leaves = Scene.flat(loaded.gaussians.take(rows), mode=plan.mode)
    leaves = replace(leaves, ids=loaded.inputs[rows].astype(np.uint32))
    part = assemble(
        forest,
        leaves,
        plan.resolved,
        seen=seen if follows else None,
        harmonics=lambda some: harmonics(work, plan, loaded, rows[some]),
        threads=threads,
    )
    part = replace(part, blocks=None, source=Source())  # the crown has the provenance
    if follows and part.tree.curves is None:  # no node follows
        part = replace(part, tree=replace(part.tree, curves=np.zeros((len(part), 4), np.float32)))
    if plan.first_roots is not None and (by_pairs or not plan.follows):
        part = _with_copies(work, plan, part)
        if follows and forest.families:
            part = _following(work, plan, part, forest, loaded, rows)
    name = work.part_name(number)
    write_plain(part, work.scene / name)
    _write_roots(work, plan, number, part, forest, follows=follows, threads=threads)
    file = stored_file(work.scene, name)
    found = {"rows": len(part), "roots": len(forest.roots), "depth": int(part.tree.depth.max()), "file": vars(file)}
    return {"leaves": len(rows), **found}


def _with_copies(work: Work, plan: Plan, part: Scene) -> Scene:
    """The crown, its leaves as copies of roots: extents are not those of balls, and they may follow the pixel."""
    assert plan.first_roots is not None and part.ids is not None
    copies = np.flatnonzero(part.tree.is_leaf)
    numbers = part.ids[copies].astype(np.int64)
    files = np.searchsorted(plan.first_roots, numbers, side="right") - 1
    shape = {name: getattr(part.gaussians, name).copy() for name in SHAPE if plan.follows}
    extents, curves = part.tree.extents.copy(), None if part.tree.curves is None else part.tree.curves.copy()
    for file in np.unique(files):
        of_file = files == file
        at, own = copies[of_file], numbers[of_file] - plan.first_roots[file]
        stored = open_scene(work.drawn(int(file)) if plan.follows else work.cell(int(file)))
        extents[at] = stored.file.rows("tree.extents")[own]
        if curves is not None:
            curves[at] = stored.file.rows("tree.curves")[own]
        for name, column in shape.items():
            column[at] = stored.file.rows(f"gaussians.{name}")[own]
    gaussians = replace(part.gaussians, **shape)
    return replace(part, gaussians=gaussians, tree=replace(part.tree, extents=extents, curves=curves))


def _following(work: Work, plan: Plan, part: Scene, forest: Forest, loaded: Loaded, rows: Array) -> Scene:
    """The crown with nodes that follow the pixel they are drawn at, by what the leaves below their roots show."""
    merged = Gaussians.concatenate(list(forest.columns[1:]))
    extents = np.concatenate([level.extents for level in forest.families if level.extents is not None])
    at = order_of(forest).row_from_node[len(rows) :]
    columns = {name: getattr(part.gaussians, name).copy() for name in SHAPE}
    assert part.tree.curves is not None
    curves = part.tree.curves.copy()
    path = work.folder / "shown_above.bin"
    try:
        numbers = np.dtype([("shown", np.float64, num_columns(plan.resolved))])
        shown = new_array(path, len(rows) + len(merged), numbers)["shown"]
        _fill_shown_of_roots(shown, work, loaded, rows)
        shown_above(shown, forest.families)
        for begin in range(0, len(merged), NODES_AT_A_TIME):
            some = slice(begin, min(begin + NODES_AT_A_TIME, len(merged)))
            of_nodes, nodes = Shown.of_columns(shown[len(rows) :][some]), merged.rows(some.start, some.stop)
            fitted, curves[at[some]] = fit_shown(nodes, extents[some], of_nodes, plan.resolved)
            for name, column in columns.items():
                column[at[some]] = getattr(fitted, name)
    finally:
        path.unlink(missing_ok=True)
    return replace(part, gaussians=replace(part.gaussians, **columns), tree=replace(part.tree, curves=curves))


def _fill_shown_of_roots(shown: Array, work: Work, loaded: Loaded, rows: Array) -> None:
    """Fill in what the leaves below each root show, in the order of ``rows``."""
    place, first = np.empty(len(rows), np.int64), 0
    place[rows] = np.arange(len(rows))
    for file in np.unique(loaded.cells):  # in the order of loading
        own = loaded.rows[loaded.cells == file]
        shown[place[first : first + len(own)]] = read_array(work.shown(int(file)))[own]
        first += len(own)


def _write_roots(
    work: Work, plan: Plan, number: int, part: Scene, forest: Forest, *, follows: bool, threads: int
) -> None:
    """Write the roots of a part, for the levels above."""
    above, roots = work.above, _roots_of(part)
    if follows:
        if plan.resolved.method == "pairs":
            write_plain(replace(roots, gaussians=roots.gaussians.with_sh_degree(0)), above.drawn(number))
        if plan.first_roots is None:
            write_array(above.shown(number), _shown(work, plan, part, threads))
        roots = replace(roots, gaussians=replace(forest.present, sh=roots.gaussians.sh))  # as they were merged
    write_plain(replace(roots, gaussians=roots.gaussians.with_sh_degree(0)), above.cell(number))
    if plan.sh_degree:
        write_array(above.harmonics(number), roots.gaussians.sh[:, 1:])
    write_bounds(above, number, roots.gaussians.means)


def _shown(work: Work, plan: Plan, part: Scene, threads: int) -> Array:
    """What the leaves below each root show."""
    is_leaf = part.tree.is_leaf
    leaves = np.flatnonzero(is_leaf)
    assert part.ids is not None
    seen = seen_of(work, plan, part.ids[leaves].astype(np.int64))
    if plan.resolved.method == "radius":
        seen_from_row = np.ones(len(part), np.float32)
        seen_from_row[leaves] = seen
        return known_of_roots(part.gaussians, part.tree, seen_from_row, threads)
    start = np.cumsum(is_leaf)[part.tree.depth == 0] - is_leaf[part.tree.depth == 0]
    return shown_of_leaves(part.gaussians.take(leaves).with_sh_degree(0), seen, start, plan.resolved).columns()


def _grown(work: Work, plan: Plan, number: int, num_levels: int, threads: int) -> tuple[Owned, Loaded]:
    box = plan.cells.boxes[number]
    radii = plan.resolved.sizes_from(plan.num_sizes, num_levels)
    for reach in reaches(box, sum(radii)):
        loaded = load(work, plan, number, reach)
        forest = _forest_of(work, plan, loaded, threads)
        try:
            region = Region(box, reach)
            return grow_region(forest, plan.resolved, region, num_levels=num_levels, threads=threads), loaded
        except TooNarrowError:
            continue
    raise AssertionError("reaches end")


def _roots_of(part: Scene) -> Scene:
    """The roots of a part as a flat scene which knows the state of growth."""
    rows = np.flatnonzero(part.tree.depth == 0)
    tree = GaussianTree(
        np.arange(1, len(rows) + 1, dtype=np.int32),
        np.zeros(len(rows), np.uint8),
        part.tree.extents[rows],
        curves=None if part.tree.curves is None else part.tree.curves[rows],
        record=part.tree.record,
        roots=part.tree.roots,
    )
    return Scene(part.gaussians.take(rows), tree, mode=part.mode)
