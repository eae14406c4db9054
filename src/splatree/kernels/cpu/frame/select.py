"""Choose the visible cut by blocks: glue over select.cpp; kernels/reference/select.py is the definition."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.cpu.frame.question import PackedQuestion, PackedSides, limit_of, pack_question, pack_sides
from splatree.scene.frame import CutRange
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Int32

__all__ = [
    "PackedCut",
    "ancestor_table",
    "pack",
    "select",
    "select_by_ancestors",
    "select_packed",
    "select_range",
    "small",
    "visible",
]


def select(
    gaussians: Gaussians,
    tree: GaussianTree,
    blocks: BlockIndex | None,
    view: View,
    options: SelectOptions,
    *,
    runs: Int32[Array, "r 2"] | None = None,
    threads: int = 0,
) -> tuple[Int32[Array, "v"], int]:
    """Rows drawn by the rule `cut`, ascending, and how many rows were looked at.

    With ``runs``, ascending first rows and ends, only rows in one of them are drawn; all others shadow as ever.
    """
    blocks = blocks or index_blocks(gaussians, tree, threads=threads)
    return select_packed(gaussians, tree, blocks, pack(view, options), runs=runs, threads=threads)


class PackedCut(NamedTuple):
    """A view and options, as the kernel takes them."""

    question: PackedQuestion
    """What is asked of each row."""
    sides: PackedSides
    """What is asked of each block."""


def pack(view: View, options: SelectOptions) -> PackedCut:
    """What `select_packed` asks, made once for a view that is selected in parts."""
    if options.rule != "cut":
        raise InputError(f"select: found rule {options.rule!r}, wanted 'cut'; the others are in NumPy only")
    question = pack_question(view, options)
    return PackedCut(question, pack_sides(view, options, question.view))


def select_packed(
    gaussians: Gaussians,
    tree: GaussianTree,
    blocks: BlockIndex,
    packed: PackedCut,
    *,
    runs: Int32[Array, "r 2"] | None = None,
    threads: int = 0,
) -> tuple[Int32[Array, "v"], int]:
    """As `select`, of what `pack` made."""
    rows, num_visited = _core.select_cut(gaussians, tree, blocks, packed.question, packed.sides, runs, threads)
    return rows, num_visited


def select_range(
    gaussians: Gaussians,
    tree: GaussianTree,
    blocks: BlockIndex | None,
    view: View,
    options: SelectOptions,
    *,
    coarsest: float,
    every: int = 1,
    runs: Int32[Array, "r 2"] | None = None,
    threads: int = 0,
) -> CutRange:
    """The cuts of all τ_R from that of the options to ``coarsest``, px and finite; of ``every`` so many blocks of rows one is
    looked at."""
    blocks = blocks or index_blocks(gaussians, tree, threads=threads)
    packed = pack(view, replace(options, pixel_error=coarsest))
    finest = limit_of(options.pixel_error, options.resolved_profile)
    return CutRange(
        *_core.select_range(gaussians, tree, blocks, packed.question, packed.sides, runs, finest, every, threads)
    )


def ancestor_table(tree: GaussianTree) -> Int32[Array, "n l"]:
    """The ancestors of each row, parent first, filled up with −1 (FilterGS §3.2): 4 bytes for each row and level but one."""
    table = np.empty((len(tree), max(tree.num_levels - 1, 0)), np.int32)
    _core.ancestor_table(tree.depth, table)
    return table


def select_by_ancestors(
    gaussians: Gaussians,
    tree: GaussianTree,
    ancestors: Int32[Array, "n l"],
    view: View,
    options: SelectOptions,
    *,
    threads: int = 0,
) -> tuple[Int32[Array, "v"], int]:
    """Rows drawn by the rules `cut`, `paper-strict` or `release`, ascending, and how many were looked at: all.

    Every row is asked on its own with its ancestors from the table, as FilterGS does; the rows are those of `select` and of
    kernels/reference/select.py.
    """
    if options.rule not in ("cut", "paper-strict", "release"):
        raise InputError(f"select_by_ancestors: found rule {options.rule!r}, wanted 'cut', 'paper-strict' or 'release'")
    question, unseen_shadow, only_leaves_ask = (
        pack_question(view, options),
        options.rule == "cut",
        options.rule == "release",
    )
    rows = _core.select_ancestors(gaussians, tree, ancestors, question, unseen_shadow, only_leaves_ask, threads)
    return rows, len(tree)


def small(
    gaussians: Gaussians,
    tree: GaussianTree,
    rows: Int32[Array, "v"],
    view: View,
    options: SelectOptions,
    *,
    threads: int = 0,
) -> Bool[Array, "v"]:
    """Whether R ≤ τ_R for each of the rows, as `select` decides it."""
    found = np.empty(len(rows), bool)
    _core.small_rows(gaussians, tree, rows, pack_question(view, options), found, threads)
    return found


def visible(
    gaussians: Gaussians,
    tree: GaussianTree,
    rows: Int32[Array, "v"],
    view: View,
    options: SelectOptions,
    *,
    threads: int = 0,
) -> Bool[Array, "v"]:
    """Whether each of the rows can be seen, as `select` decides it."""
    if options.view_test == "none":
        return np.ones(len(rows), bool)
    found = np.empty(len(rows), bool)
    _core.visible_rows(gaussians, tree, rows, pack_question(view, options), found, threads)
    return found
