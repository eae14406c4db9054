"""A scene as a folder of parts, which a build of a scene larger than memory writes: ``city.splatree/``.

``manifest.json`` names the files. Each part is a ``.splatree`` of whole subtrees. ``crown.splatree`` holds the nodes above: a
small tree whose leaves are copies of the roots of the parts. In the whole tree, the subtree of each root takes the place of its
copy, so that rows are in preorder. docs/reference/formats/folder.md.
"""

from dataclasses import replace
from pathlib import Path

from splatree.io.chunks import Chunks
from splatree.io.formats.folder.manifest import MANIFEST, folder_of, holds_parts, is_manifest, read_manifest
from splatree.io.formats.folder.whole import open_whole
from splatree.io.options import ReadOptions
from splatree.io.runs import TreeRuns
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.scene.scene import Scene


def sniff(path: Path, head: bytes) -> bool:
    """Whether the path is a scene in parts, or its manifest; servers of https do not tell folders."""
    return path.name == MANIFEST and is_manifest(path) if path.is_file() else holds_parts(path)


def files(path: Path) -> list[Path]:
    """The manifest and all files that it names."""
    path = folder_of(path)
    manifest = read_manifest(path)
    index = () if manifest.index is None else (manifest.index,)
    return [path / MANIFEST, *(path / file.name for file in (*index, manifest.crown, *manifest.parts))]


def read(path: Path, options: ReadOptions) -> Scene:
    """The whole tree in memory.

    Raises:
        FormatError: a file is not the one that the manifest speaks of, or the files do not fit each other.
        InputError: there are 2³¹ rows or more.
    """
    scene = open_whole(folder_of(path)).scene()
    return replace(scene, blocks=index_blocks(scene.gaussians, scene.tree))


def read_leaves(path: Path, options: ReadOptions) -> Chunks | None:
    """The leaves in chunks, as they lie in the whole tree; None where values may be repaired, which trees do not bear."""
    return None if options.repair else open_whole(folder_of(path)).leaves()


def read_runs(path: Path) -> TreeRuns:
    """The rows of the whole tree."""
    whole = open_whole(folder_of(path))
    return TreeRuns(whole.head, whole.num_leaves, whole.runs)
