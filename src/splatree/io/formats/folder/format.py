"""A scene as a folder of parts, which a build of a scene larger than memory writes: ``city.splatree/``.

``manifest.json`` names the files. Each part is a ``.splatree`` of whole subtrees. ``crown.splatree`` holds the nodes above: a
small tree whose leaves are copies of the roots of the parts. In the whole tree, the subtree of each root takes the place of its
copy, so that rows are in preorder. Parts are mapped, checked and copied, each to its place. docs/reference/formats/folder.md.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, checked_path, is_manifest, read_manifest
from splatree.io.formats.splatree import format as single
from splatree.io.options import ReadOptions
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Int64


def sniff(path: Path, head: bytes) -> bool:
    """Whether the path is a folder with such a manifest."""
    return path.is_dir() and is_manifest(path / MANIFEST)


def files(path: Path) -> list[Path]:
    """The manifest and all files that it names."""
    manifest = read_manifest(path)
    index = () if manifest.index is None else (manifest.index,)
    return [path / MANIFEST, *(path / file.name for file in (*index, manifest.crown, *manifest.parts))]


def read(path: Path, options: ReadOptions) -> Scene:
    """The whole tree in memory.

    Raises:
        FormatError: a file is not the one that the manifest speaks of, or the files do not fit each other.
        InputError: there are 2³¹ rows or more.
    """
    manifest = read_manifest(path)
    if manifest.num_rows >= 2**31:
        raise InputError(f"{path}: found {manifest.num_rows} rows, wanted less than 2^31 in one scene in memory")
    options = replace(options, repair=False)
    with task(f"read {path.name}", float(manifest.num_rows)) as advance:
        crown = single.read(checked_path(path, manifest.crown), options)
        rows = _Rows.under(crown, manifest, path)
        for file in manifest.parts:
            part = single.read(checked_path(path, file), options)
            rows.add(part, path / file.name)
            advance(float(len(part)))
        return rows.whole()


@dataclass(eq=False)
class _Rows:
    """The rows of the whole tree as they are filled in."""

    path: Path
    crown: Scene
    copies: Int64[Array, "r"]
    """Row in the crown of the copy of each root, numbered part by part."""
    num_rows_of: Int64[Array, "s"]
    """How many rows of the whole tree each row of the crown stands for; of a copy, one before its subtree is known."""
    sizes: list[Array]
    """Of each part so far, how many rows are below each of its roots, and the root itself."""
    parts: list[Scene]
    num_rows: int
    num_roots: int = 0

    @staticmethod
    def under(crown: Scene, manifest: Manifest, path: Path) -> "_Rows":
        is_leaf = crown.tree.is_leaf
        leaves = np.flatnonzero(is_leaf)
        if crown.ids is None:
            raise FormatError(
                f"{path / manifest.crown.name}: found no ids, wanted the numbers of the roots of all parts"
            )
        copies = leaves[np.argsort(crown.ids[leaves], kind="stable")]
        if not np.array_equal(crown.ids[copies], np.arange(len(copies))):
            raise FormatError(f"{path / manifest.crown.name}: found ids of leaves that are not 0 to {len(copies) - 1}")
        return _Rows(path, crown, copies, np.ones(len(crown), np.int64), [], [], manifest.num_rows)

    def add(self, part: Scene, where: Path) -> None:
        """Take the rows of the next part."""
        roots = np.flatnonzero(part.tree.depth == 0)
        first, self.num_roots = self.num_roots, self.num_roots + len(roots)
        if self.num_roots > len(self.copies):
            raise FormatError(f"{where}: found more roots than the {len(self.copies)} that the crown has copies of")
        copies = self.copies[first : self.num_roots]
        if part.gaussians.sh.shape[1:] != self.crown.gaussians.sh.shape[1:] or not np.array_equal(
            part.gaussians.means[roots], self.crown.gaussians.means[copies]
        ):
            raise FormatError(f"{where}: found roots that are not those of the crown; the file is of another build")
        self.num_rows_of[copies] = part.tree.subtree_end[roots] - roots
        self.parts.append(part)

    def whole(self) -> Scene:
        """The scene of all rows."""
        crown, is_leaf = self.crown, self.crown.tree.is_leaf
        first_row = np.concatenate([[0], np.cumsum(self.num_rows_of)])
        n = int(first_row[-1])
        if self.num_roots != len(self.copies) or n != self.num_rows:
            raise FormatError(
                f"{self.path / MANIFEST}: found {n} rows and {self.num_roots} roots in the files, wanted {self.num_rows} and "
                f"{len(self.copies)}"
            )
        above, above_rows = np.flatnonzero(~is_leaf), first_row[:-1][~is_leaf]
        columns = {
            f.name: np.empty((n, *getattr(crown.gaussians, f.name).shape[1:]), np.float32) for f in fields(Gaussians)
        }
        for name, column in columns.items():
            column[above_rows] = getattr(crown.gaussians, name)[above]
        end, depth = np.empty(n, np.int32), np.empty(n, np.int64)
        extents, ids = np.empty(n, np.float32), np.empty(n, np.uint32)
        curves = None if crown.tree.curves is None else np.zeros((n, 4), np.float32)
        if curves is not None:
            assert crown.tree.curves is not None
            curves[above_rows] = crown.tree.curves[above]
        end[above_rows] = first_row[crown.tree.subtree_end[above]]
        depth[above_rows], extents[above_rows] = crown.tree.depth[above], crown.tree.extents[above]
        num_roots = 0
        while self.parts:  # each is given back once its rows are copied
            part = self.parts.pop(0)
            roots = np.flatnonzero(part.tree.depth == 0)
            copies = self.copies[num_roots : num_roots + len(roots)]
            num_roots += len(roots)
            sizes = part.tree.subtree_end[roots] - roots
            shifts = np.repeat(first_row[copies] - roots, sizes)
            rows = shifts + np.arange(len(part))
            for name, column in columns.items():
                column[rows] = getattr(part.gaussians, name)
            end[rows] = part.tree.subtree_end + shifts
            depth[rows] = part.tree.depth + np.repeat(crown.tree.depth[copies].astype(np.int64), sizes)
            extents[rows] = part.tree.extents
            if curves is not None and part.tree.curves is not None:
                curves[rows] = part.tree.curves
            ids[rows] = np.arange(len(part)) if part.ids is None else part.ids
        if depth.max(initial=0) > 255:
            raise FormatError(f"{self.path}: found a node {depth.max()} levels below its root, wanted at most 255")
        tree = GaussianTree(
            end, depth.astype(np.uint8), extents, curves=curves, record=crown.tree.record, roots=crown.tree.roots
        )
        first_id = int(ids[tree.is_leaf].max(initial=0)) + 1
        if first_id + n > 2**32:
            raise FormatError(
                f"{self.path}: found identities of leaves up to {first_id - 1}, which leave no room for nodes"
            )
        ids[~tree.is_leaf] = first_id + np.flatnonzero(~tree.is_leaf)
        gaussians = Gaussians(**columns)
        return replace(crown, gaussians=gaussians, tree=tree, ids=ids, blocks=index_blocks(gaussians, tree))
