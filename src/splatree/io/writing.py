"""Write scenes in the format of a path's suffix, whole or not at all, and say what the file does not hold."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from splatree.errors import InputError, OutputError, SplatreeError
from splatree.io.chunks import Chunks, chunks_of
from splatree.io.cut import cut_at
from splatree.io.holds import losses, origin_lost
from splatree.io.objects import ObjectPath, located
from splatree.io.options import WriteOptions
from splatree.io.registry import FOLDER_FILE, Format, format_to_write
from splatree.io.replacing import replacing
from splatree.scene.arguments import checked
from splatree.scene.given import given
from splatree.scene.scene import Scene


@checked
def write(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    force: bool = False,
    depth: int | None = None,
    options: WriteOptions | None = None,
) -> tuple[str, ...]:
    """Write a scene in the format of the path's suffix, whole or not at all.

    A format without levels gets one cut of the tree: the leaves, or with ``depth`` the nodes at that depth and the leaves above
    it (0: the roots, the coarsest picture).

    Args:
        scene: what to write.
        path: the new file.
        force: replace the file if it exists.
        depth: which cut to write; None: the leaves, or the whole tree if the format keeps it.
        options: how to write; None: as the format does by default.

    Returns:
        What the file does not hold, a sentence each; none if reading gives the same scene.

    Raises:
        InputError: no format that is written has this suffix, it does not take an option, or ``depth`` is negative.
        OutputError: the file exists, or could not be written; an old file is then whole.

    Example:
        >>> st.write(scene, "copy.splatree", force=True)
        ()
    """
    target, options = located(path), given(options, WriteOptions, "write: options")
    chosen = format_to_write(target)
    options.check_taken(chosen.options, f"{target} ({chosen.name})")
    num_merged, clusters = 0, scene.clusters
    if depth is not None or chosen.holds.levels != "tree":
        num_merged = len(scene) - scene.tree.num_leaves if depth is None else 0
        scene = cut_at(scene, depth)
    keeps_clusters = chosen.holds.clusters and scene.clusters is clusters
    lost: Iterable[str] = losses(
        chosen.holds,
        chosen.name,
        sh_degree=scene.gaussians.sh_degree,
        mode=scene.mode,
        threshold=scene.threshold,
        num_merged=num_merged,
        num_clusters=0 if clusters is None or keeps_clusters else len(clusters),
        record=scene.tree.record if scene.tree.depth.any() else None,
        has_curves=scene.tree.curves is not None and bool(scene.tree.depth.any()),
    )
    lost = (*lost, *origin_lost(chosen.holds, chosen.name, scene.source.origin))
    if chosen.write is None:
        return (*lost, *_written(chosen, chunks_of(scene), target, force, options))
    with replacing(target, force=force) as temporary:
        return (*lost, *chosen.write(scene, temporary, options))


@contextmanager
def _folder_of(target: Path) -> Iterator[None]:
    """The folder is the scene: make it, if it is not there, and take it away if it stays empty."""
    folder = target.parent
    made = not folder.exists() and folder.parent.is_dir()
    try:
        if made:
            folder.mkdir()
        yield
    except OSError as error:
        if isinstance(error, SplatreeError):
            raise
        raise OutputError(f"{folder}: cannot be made a folder ({error.strerror or error})") from error
    finally:
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def write_chunks(
    chunks: Chunks,
    path: str | os.PathLike[str],
    *,
    force: bool = False,
    options: WriteOptions | None = None,
) -> tuple[str, ...]:
    """As `write`, of Gaussians in chunks, in a format that is written so."""
    target, options = located(path), given(options, WriteOptions, "write: options")
    chosen = format_to_write(target)
    options.check_taken(chosen.options, f"{target} ({chosen.name})")
    lost: Iterable[str] = losses(
        chosen.holds,
        chosen.name,
        sh_degree=chunks.sh_degree,
        mode=chunks.mode,
        threshold=chunks.threshold,
        num_merged=chunks.num_merged,
        num_clusters=chunks.num_clusters,
    )
    lost = (*lost, *origin_lost(chosen.holds, chosen.name, chunks.origin))
    return (*lost, *_written(chosen, chunks, target, force, options))


def _written(chosen: Format, chunks: Chunks, target: Path, force: bool, options: WriteOptions) -> tuple[str, ...]:
    if chosen.write_chunks is None:
        raise InputError(f"{target}: format {chosen.name} is not written in chunks; wanted a whole scene")
    if target.name == FOLDER_FILE and chosen.write_folder is not None:
        folder = nullcontext() if isinstance(target, ObjectPath) else _folder_of(target)  # stores have no empty folders
        with folder, replacing(target, force=force) as temporary:
            return chosen.write_folder(chunks, temporary, options)
    with replacing(target, force=force) as temporary:
        return chosen.write_chunks(chunks, temporary, options)
