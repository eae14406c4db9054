"""From what a user names to the files of a scene: folders of chunks, training outputs, patterns."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from splatree.errors import InputError
from splatree.io.foreign import advice

_HEAD_BYTES = 1024


def find_inputs(paths: Sequence[Path], is_scene: Callable[[Path], bool]) -> list[Path]:
    """The files and folders to read, in order; ``is_scene`` says whether a path is of a known format."""
    if not paths:
        raise InputError("read: found no paths, wanted at least one")
    return [found for path in paths for found in _find(path, is_scene)]


def _find(path: Path, is_scene: Callable[[Path], bool]) -> list[Path]:
    try:
        is_there = path.exists()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not is_there:
        return _match(path)
    if is_scene(path):
        return [path]
    if not path.is_dir():
        if path.is_file():  # a pipe would wait
            with path.open("rb") as file:
                known = advice(path, file.read(_HEAD_BYTES))
            if known:
                raise InputError(f"{path}: {known}")
        raise InputError(
            f"{path}: of no known format, by content or by suffix; `splatree formats` lists those that are read"
        )
    if newest := newest_iteration(path):
        return [newest]
    found = [child for child in sorted(path.iterdir(), key=_natural) if is_scene(child)]
    if not found:
        raise InputError(
            f"{path}: found no scene in this folder; wanted scene files, folders with meta.json or lod-meta.json, "
            "or point_cloud/iteration_*/point_cloud.ply"
        )
    return found


def newest_iteration(folder: Path) -> Path | None:
    """The latest point_cloud.ply of a training output or of its point_cloud folder; None if the folder is something else."""
    files = {
        int(match[1]): file
        for pattern in ("point_cloud/iteration_*/point_cloud.ply", "iteration_*/point_cloud.ply")
        for file in folder.glob(pattern)
        if (match := re.fullmatch(r"iteration_(\d+)", file.parent.name))
    }
    return files[max(files)] if files else None


def _match(path: Path) -> list[Path]:
    """What a pattern that no shell has expanded stands for."""
    if any(c in str(path) for c in "*?["):
        start = Path(path.anchor) if path.is_absolute() else Path()
        found = sorted(start.glob(str(path.relative_to(start))), key=_natural)
        if found:
            return found
        raise InputError(f"{path}: no file matches this pattern")
    raise InputError(f"{path}: not found; wanted a scene file or folder")


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key by which chunk_9 comes before chunk_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
