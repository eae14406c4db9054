"""The formats, one line each, and the functions that read and write by them.

A format is recognised by its content first (`sniff`) and by its suffix second. A new one is a module with ``sniff``, ``read``
and ``write`` (or no ``write``) and a line in `FORMATS`; order matters only where two would claim the same file.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from splatree.errors import InputError, SplatreeError
from splatree.io import ply, sog, splat, store, streamed_sog
from splatree.io.inputs import find_inputs
from splatree.io.joined import joined
from splatree.io.options import ReadOptions
from splatree.io.replacing import replacing
from splatree.scene.scene import Scene

_HEAD_BYTES = 4096
"""How much of a file `sniff` is given."""


@dataclass(frozen=True)
class Format:
    """A kind of file or folder that holds a scene."""

    name: str
    """Short name, as in `Source.format`."""
    description: str
    """One line for tables."""
    suffixes: tuple[str, ...]
    """Endings of file names, lower case; empty if it is a folder."""
    versions: str
    """Versions that are read."""
    lossless: bool
    """Whether what is written reads back bit for bit."""
    levels: Literal["none", "one of", "tree"]
    """Levels of detail: the file has none; `read` takes one of several; the file keeps the tree."""
    sniff: Callable[[Path, bytes], bool]
    """Whether a path holds this format, given the first bytes of a file (none for a folder)."""
    read: Callable[[Path, ReadOptions], Scene]
    """Read a path into a scene whose values were checked (`splatree.io.check.checked`)."""
    write: Callable[[Scene, Path], None] | None = None
    """Write a file; None if the format is only read."""


FORMATS: tuple[Format, ...] = (
    Format("splatree", "native, with levels", (".splatree",), "1", True, "tree", store.sniff, store.read, store.write),
    Format("ply", "3DGS training output", (".ply",), "SH 0-3", True, "none", ply.sniff, ply.read, ply.write),
    Format("splat", "antimatter15, 32 bytes", (".splat",), "-", False, "none", splat.sniff, splat.read, splat.write),
    Format("sog", "PlayCanvas SOG", (".sog",), "1, 2", False, "none", sog.sniff, sog.read),
    Format("streamed-sog", "PlayCanvas streamed SOG", (), "1", False, "one of", streamed_sog.sniff, streamed_sog.read),
)


def formats() -> tuple[Format, ...]:
    """All formats, in the order in which they are tried."""
    return FORMATS


def read(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], *, level: int | None = None, repair: bool = False
) -> Scene:
    """Read one scene from a file, a folder, or several of them.

    A folder may be a format of its own (SOG, streamed SOG), a training output (its newest ``point_cloud/iteration_*`` is
    taken) or hold chunks of one scene: every scene file and folder in it is read. Several inputs are joined in their order.
    A single input that matches no file but holds ``* ? [`` is expanded as a pattern.

    Args:
        path: one path or several.
        level: level of detail to take from a format that has several; 0, the default, is the finest.
        repair: fix or drop values that cannot be used, and count them in ``source.metadata["repairs"]``, instead of raising.

    Raises:
        FormatError: a file does not hold what it promises; the message says where and what to do.
        InputError: nothing is there, or it is of no known format, or the inputs cannot be joined.
    """
    options = ReadOptions(level, repair)
    paths = [path] if isinstance(path, str | os.PathLike) else list(path)
    inputs = find_inputs([Path(p) for p in paths], lambda p: detect(p) is not None)
    return joined(_read_one(p, options) for p in inputs)


def write(scene: Scene, path: str | os.PathLike[str], *, force: bool = False, depth: int | None = None) -> None:
    """Write a scene in the format of the path's suffix, whole or not at all.

    A format without levels gets one cut of the tree: the leaves, or with ``depth`` the nodes at that depth and the leaves
    above it (0: the roots, the coarsest picture).

    Args:
        scene: what to write.
        path: the new file.
        force: replace the file if it exists.
        depth: which cut to write; None: the leaves, or the whole tree if the format keeps it.

    Raises:
        InputError: no format that is written has this suffix, or ``depth`` is negative.
        OutputError: the file exists, or could not be written; an old file is then whole.
    """
    target = Path(path)
    written = [f for f in FORMATS if f.write is not None]
    chosen = next((f for f in written if target.name.lower().endswith(f.suffixes)), None)
    if chosen is None or chosen.write is None:
        known = " ".join(suffix for f in written for suffix in f.suffixes)
        raise InputError(f"{target}: cannot be written, its suffix is {target.suffix!r}; wanted one of {known}")
    if depth is not None or chosen.levels != "tree":
        scene = _cut(scene, depth)
    with replacing(target, force=force) as temporary:
        chosen.write(scene, temporary)


def detect(path: Path) -> Format | None:
    """The format of a file or folder: by content, else by suffix."""
    head = b""
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    for f in FORMATS:
        if f.sniff(path, head):
            return f
    if path.is_file():
        return next((f for f in FORMATS if f.suffixes and path.name.lower().endswith(f.suffixes)), None)
    return None


def _read_one(path: Path, options: ReadOptions) -> Scene:
    found = detect(path)
    if found is None:
        raise InputError(f"{path}: of no known format; known are {', '.join(f.name for f in FORMATS)}")
    if options.level is not None and found.levels != "one of":
        raise InputError(
            f"{path}: found level {options.level} for a file of format {found.name}, which has no levels to choose"
        )
    try:
        scene = found.read(path, options)
    except OSError as error:
        if isinstance(error, SplatreeError):
            raise
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    return replace(scene, source=replace(scene.source, paths=(str(path),), format=found.name))


def _cut(scene: Scene, depth: int | None) -> Scene:
    """The leaves, or the nodes at a depth and the leaves above it, as a flat scene."""
    if depth is not None and depth < 0:
        raise InputError(f"write: found depth {depth}, wanted 0 (the roots) or more")
    drawn = scene.tree.is_leaf
    if depth is not None:
        drawn = (drawn & (scene.tree.depth < depth)) | (scene.tree.depth == depth)
    if drawn.all():
        return scene
    flat = Scene.flat(scene.gaussians.take(np.flatnonzero(drawn)), mode=scene.mode, source=scene.source)
    return replace(flat, threshold=scene.threshold)
