"""The whole tree of a folder as one mapped file, for programs that look at rows in an order of their own.

A mapped column takes no memory that the system could not take back. One ``.splatree`` is mapped as it is. The parts of a folder
are put together first, in a file beside what is to be written; it is removed in the end.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from splatree.io.formats.folder.whole import open_whole
from splatree.io.formats.splatree.writer import create_scene
from splatree.io.reading import read
from splatree.outofcore.lock import alone_in
from splatree.scene.scene import Scene

__all__ = ["mapped_whole"]


@contextmanager
def mapped_whole(folder: Path, beside: Path) -> Iterator[Scene]:
    """The tree of a folder of parts, mapped from a file that lies in ``BESIDE.work/`` as long as the context lasts.

    Args:
        folder: the folder, as `build_folder` makes it.
        beside: what will be written; there has to be room for the whole tree beside it.

    Raises:
        FormatError: a file of the folder is damaged.
        OutputError: the file cannot be written, or another process writes the same output.
    """
    work = beside.with_name(f"{beside.name}.work")
    file = work / "whole.splatree"
    tree = open_whole(folder)
    with alone_in(work):
        try:
            with create_scene(file, tree.head, force=True, pages=False) as writer:
                for run in tree.runs(f"put {folder.name} together"):
                    writer.append(run)
            scene = read(file)
            yield replace(scene, source=replace(scene.source, paths=(str(folder),), format="splatree-folder"))
        finally:
            file.unlink(missing_ok=True)
