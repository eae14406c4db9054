"""Read some rows of a ``.splatree`` and nothing else of it.

`open_scene` reads the header. `StoredScene.rows` maps the rows that are asked for, checks their values and leaves the rest of the
file on the disk. So a program can go through a scene that is larger than memory.
"""

import os
from dataclasses import dataclass, fields, replace

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.check import checked_rows, magnitudes_of
from splatree.io.formats.splatree.container import Container, open_container
from splatree.io.formats.splatree.fields import column_types, source_from, struct_from, value_of
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.older import record_of_provenance
from splatree.io.levels import check_extents
from splatree.io.objects import located
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import LevelRecord
from splatree.scene.roots import Roots
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Int32, UInt8, UInt32, check_fields

__all__ = ["SceneRows", "StoredScene", "open_scene"]


@dataclass(frozen=True, eq=False)
class SceneRows:
    """A run of rows of a scene, with or without levels.

    Example:
        >>> rows = st.SceneRows.of(scene)
        >>> rows.begin, len(rows) == len(scene)
        (0, True)
    """

    begin: int
    """First row, counted in the scene."""
    gaussians: Gaussians
    """The Gaussians of the rows."""
    subtree_end: Int32[Array, "n"]
    """One past the last row of the subtree of each row, counted in the scene."""
    depth: UInt8[Array, "n"]
    """Edges from the root, in the scene."""
    extents: Float32[Array, "n"]
    """Extent of each row, world units (`GaussianTree.extents`)."""
    ids: UInt32[Array, "n"] | None
    """Identity of each row; None: the row number."""
    curves: Float32[Array, "n 4"] | None = None
    """How each row follows the pixel that it is drawn at (`GaussianTree.curves`)."""

    def __post_init__(self) -> None:
        check_fields(self, n=len(self.gaussians))

    def __len__(self) -> int:
        return len(self.gaussians)

    @staticmethod
    def of(scene: Scene) -> "SceneRows":
        """All rows of a scene in memory."""
        tree = scene.tree
        return SceneRows(0, scene.gaussians, tree.subtree_end, tree.depth, tree.extents, scene.ids, tree.curves)

    def part(self, begin: int, end: int) -> "SceneRows":
        """Some of the rows, counted in the scene, as copies; all of them as they are.

        Example:
            >>> len(st.SceneRows.of(scene).part(3, 5))
            2
        """
        if (begin, end) == (self.begin, self.begin + len(self)):
            return self
        first, last = begin - self.begin, end - self.begin
        return SceneRows(
            begin,
            self.gaussians.take(np.arange(first, last)),
            self.subtree_end[first:last].copy(),
            self.depth[first:last].copy(),
            self.extents[first:last].copy(),
            None if self.ids is None else self.ids[first:last].copy(),
            None if self.curves is None else self.curves[first:last].copy(),
        )

    def scene(self, head: SceneHead) -> Scene:
        """The rows as a scene of their own, drawn as ``head`` says.

        Raises:
            InputError: the rows are not whole subtrees of siblings.
        """
        n, top = len(self), int(self.depth.min(initial=255)) if len(self) else 0
        if n and (int(self.subtree_end.max()) > self.begin + n or int(self.depth[0]) != top):
            raise InputError(
                f"rows {self.begin} to {self.begin + n}: found subtrees that reach beyond them, or rows above the first; wanted "
                "whole subtrees of siblings"
            )
        tree = GaussianTree(
            self.subtree_end - np.int32(self.begin), self.depth - np.uint8(top), self.extents, self.curves, head.record
        )
        ids = self.ids if self.ids is not None else np.arange(self.begin, self.begin + n, dtype=np.uint32)
        scene = Scene(self.gaussians, tree, ids, mode=head.mode, threshold=head.threshold, tile_rule=head.tile_rule)
        blocks = index_blocks(self.gaussians, tree) if tree.depth.any() else None
        return replace(scene, blocks=blocks, source=head.source)


@dataclass(frozen=True, eq=False)
class StoredScene:
    """A ``.splatree`` whose rows are read when they are asked for; `open_scene` opens one.

    Example:
        >>> stored = st.open_scene("city.splatree")
        >>> len(stored.rows(0, 10))
        10
    """

    head: SceneHead
    """How many rows there are, and how they are drawn."""
    file: Container
    """The file."""

    def __len__(self) -> int:
        return self.head.num_rows

    def rows(self, begin: int, end: int, *, harmonics: bool | None = True) -> SceneRows:
        """Map the rows ``begin`` to ``end`` and check their values; no other row is read.

        Args:
            begin: first row, 0 or more.
            end: one past the last row, at most the number of rows.
            harmonics: check the harmonics too. False: they are mapped, but not read; of an object of a store they are fetched,
                but not checked. None: they are zeros, which take no memory, and those of the file are not asked for; nor are
                curves, which are None.

        Returns:
            The rows, read-only, as views of the file. They stay valid when the handle is gone.

        Raises:
            InputError: there are no such rows.
            FormatError: a value cannot be used.
        """
        if not 0 <= begin <= end <= len(self):
            raise InputError(
                f"{self.file.path}: found rows {begin} to {end}, wanted some of the {len(self)} rows there are"
            )
        where, file, sh = str(self.file.path), self.file, "gaussians.sh"
        wanted = [f"gaussians.{f.name}" for f in fields(Gaussians) if harmonics is not None or f.name != "sh"]
        wanted += [f"tree.{name}" for name in ("subtree_end", "depth", "extents")]
        wanted += ["ids"] * self.head.has_ids + ["tree.curves"] * (self.head.has_curves and harmonics is not None)
        columns = dict(zip(wanted, file.rows_of(wanted, begin, end), strict=True))
        if harmonics is None:
            columns[sh] = np.zeros((end - begin, *file.columns[sh].shape[1:]), np.float32)
        mapped = Gaussians(*(columns[f"gaussians.{f.name}"] for f in fields(Gaussians)))
        magnitudes = None if harmonics else magnitudes_of(mapped, sh=0.0)
        gaussians, _ = checked_rows(mapped, where, repair=False, magnitudes=magnitudes, first_row=begin)
        end_of, depth, extents = (columns[f"tree.{name}"] for name in ("subtree_end", "depth", "extents"))
        rows = SceneRows(begin, gaussians, end_of, depth, extents, columns.get("ids"), columns.get("tree.curves"))
        check_extents(rows.extents, where, first_row=begin)
        wrong = (rows.subtree_end <= np.arange(begin, end)) | (rows.subtree_end > len(self))
        if wrong.any():
            i = int(np.argmax(wrong))
            raise FormatError(
                f"{where}: row {begin + i}, tree.subtree_end: found {rows.subtree_end[i]}, wanted {begin + i + 1} to {len(self)}"
            )
        return rows

    def forget(self, begin: int, end: int) -> None:
        """Let the system take back the memory of mapped rows; they are read again when they are used again.

        Example:
            >>> stored = st.open_scene("city.splatree")
            >>> stored.forget(0, len(stored))
        """
        for name in self.file.columns:
            if self.file.columns[name].shape[:1] == (len(self),):
                self.file.forget(name, begin, end)


@checked
def open_scene(path: str | os.PathLike[str]) -> StoredScene:
    """Open a ``.splatree`` to read some of its rows.

    Args:
        path: the file; of another format, convert it first.

    Returns:
        A handle; nothing but the header has been read.

    Raises:
        FormatError: the file is no ``.splatree``, cut off or damaged.
        InputError: the file cannot be read, or is compact.

    Example:
        >>> import splatree as st
        >>> _ = st.write(st.Scene.flat(st.Gaussians.empty()), "empty.splatree", force=True)
        >>> len(st.open_scene("empty.splatree").rows(0, 0))
        0
    """
    try:
        file = open_container(located(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if file.is_compact:
        raise InputError(
            f"{path}: found a compact file, whose rows cannot be read one by one; wanted an exact one: "
            f"splatree convert {path} exact.splatree"
        )
    try:
        return StoredScene(_head_of(file), file)
    except FormatError:
        raise
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


def _roots_of(file: Container, where: str) -> Roots | None:
    names = [name for name in file.columns if name.startswith("tree.roots.")]
    columns = dict(zip(names, file.rows_of(names), strict=True))
    return struct_from(Roots, "tree.roots.", columns, file.values, where) if columns else None


def _head_of(file: Container) -> SceneHead:
    where, columns, values = str(file.path), file.columns, file.values
    sh = columns.get("gaussians.sh")
    if sh is None or len(sh.shape) != 3 or sh.shape[1] not in (1, 4, 9, 16) or sh.shape[2] != 3:
        raise FormatError(
            f"{where}: gaussians.sh: found {sh and sh.shape}, wanted rows of 1, 4, 9 or 16 coefficients of RGB"
        )
    n, has_ids, has_curves = sh.shape[0], "ids" in columns, "tree.curves" in columns
    for name, (dtype, shape) in column_types(n, sh.shape[1], has_ids=has_ids, has_curves=has_curves).items():
        found = columns.get(name)
        if found is None or found.shape != shape or found.dtype != dtype:
            said = "no such column" if found is None else f"{found.dtype.name} of shape {found.shape}"
            raise FormatError(
                f"{where}: {name}: found {said}, wanted {dtype.name} of shape {shape}; the file is damaged"
            )
    source = source_from(values, "source", where)
    record = None
    if "tree.record" in values:
        record = LevelRecord.from_json(str(values["tree.record"]))
    elif "levels" in source.metadata:
        record = record_of_provenance(source.metadata["levels"])
    try:
        return SceneHead(
            num_rows=n,
            sh_degree=(1, 4, 9, 16).index(sh.shape[1]),
            mode=value_of(values, "mode", where),
            threshold=value_of(values, "threshold", where),
            tile_rule=value_of(values, "extent", where) if "extent" in values else None,
            record=record,
            has_ids=has_ids,
            has_curves=has_curves,
            roots=_roots_of(file, where),
            source=replace(source, paths=(where,), format="splatree"),
        )
    except TypeError as error:
        raise FormatError(f"{where}: {error}") from error
