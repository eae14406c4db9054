"""From what a user names to the files of a scene: folders of chunks, training outputs, patterns."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from splatree.errors import InputError
from splatree.io.foreign import advice, advice_for_folder

_HEAD_BYTES = 1024

_STATES = (
    "splat",
    "splats",
    "iteration",
    "iter",
    "step",
    "point_cloud",
    "export",
    "checkpoint",
    "ckpt",
    "epoch",
    "model",
    "it",
)
"""Ends of names before the number of steps, as LichtFeld, OpenSplat, Brush, gsplat and others write them."""


@dataclass(frozen=True)
class Inputs:
    """What to read."""

    paths: list[Path]
    """Files and folders, each a scene or a part of one, in order."""
    notes: tuple[str, ...]
    """Which of several were taken, a sentence each."""


def find_inputs(paths: Sequence[Path], is_scene: Callable[[Path], bool]) -> Inputs:
    """The files and folders to read; ``is_scene`` says whether a path is of a known format.

    Raises:
        InputError: there is nothing to read, or it is not clear which of several files is meant.
    """
    if not paths:
        raise InputError("read: found no paths, wanted at least one")
    notes: list[str] = []
    found = [each for path in paths for each in _find(path, is_scene, notes)]
    first, times = dict[tuple[int, int], Path](), Counter[tuple[int, int]]()
    for path in found:
        stat = path.stat()  # a file is one, whatever links lead to it
        first.setdefault(key := (stat.st_dev, stat.st_ino), path)
        times[key] += 1
    notes += [
        f"{first[key]} is named {count} times: its Gaussians stand there as often"
        for key, count in times.items()
        if count > 1
    ]
    return Inputs(found, tuple(notes))


def check_are_there(paths: Iterable[Path]) -> None:
    """Refuse what no reader could find, where more is to be said of it than that.

    Raises:
        InputError: a path leads nowhere, and is no pattern of one that does.
    """
    for path in paths:
        if str(path) != "-" and not path.exists():
            _match(path)


def _find(path: Path, is_scene: Callable[[Path], bool], notes: list[str]) -> list[Path]:
    try:
        is_there = path.exists()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not is_there:
        return [found for match in _match(path) for found in _find(match, is_scene, notes)]
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
    if iterations := _iterations(path):
        newest = iterations[max(iterations)]
        if len(iterations) > 1:
            notes.append(
                f"{path} holds {len(iterations)} states of one training; the newest, {newest.parent.name}, is taken"
            )
        return [newest]
    found = [child for child in sorted(path.iterdir(), key=_natural) if is_scene(child)]
    if not found:
        if known := advice_for_folder(path):
            raise InputError(f"{path}: {known}")
        raise InputError(
            f"{path}: found no scene in this folder; wanted scene files, folders with meta.json or lod-meta.json, "
            "or point_cloud/iteration_*/point_cloud.ply"
        )
    return _without_older_states(path, found, notes)


def _without_older_states(folder: Path, found: list[Path], notes: list[str]) -> list[Path]:
    """The files less those that are earlier states of the training which another is the last state of."""
    if len(found) < 2:
        return found
    series: dict[str, dict[int, list[Path]]] = {}
    for path in found:
        if match := re.fullmatch(r"(.*?)(\d+)", _stem(path)):
            series.setdefault(match[1].lower(), {}).setdefault(int(match[2]), []).append(path)
    for prefix, states in series.items():
        others = [path for path in found if all(path not in of for of in states.values())]
        final = [path for path in others if _stem(path).lower() == prefix.rstrip("_- ")]
        if len(states) + len(final) < 2 or not _are_iterations(states):
            continue
        name = f"{prefix}{max(states)}"
        taken = final or states[max(states)]
        others = [path for path in others if path not in final]
        if others or len(taken) > 1 or not prefix.strip("_- ").endswith(_STATES):
            listed = ", ".join(path.name for path in found[:5]) + (", ..." if len(found) > 5 else "")
            raise InputError(
                f"{folder}: found {listed}, which look like states of one training beside each other, or like pieces of a scene; "
                f"name the files to read: the last state is {taken[0].name}"
            )
        notes.append(
            f"{folder} holds {len(found)} states of one training; the {'final' if final else 'newest'}, "
            f"{taken[0].name if final else name}, is taken; name another file to take that"
        )
        return taken
    if levels := [path for path in found if re.search(r"lod[_-]?\d+$", _stem(path), re.IGNORECASE)][1:]:
        raise InputError(
            f"{folder}: found {levels[0].name} beside others of such names, levels of detail of one scene by their names; name "
            "the file to read"
        )
    names: dict[str, Path] = {}
    for path in found:
        if (original := _original(path, found)) is not None:
            raise InputError(
                f"{folder}: found {path.name} beside {original.name}, another version of one scene by their names; name the file "
                "to read, or both if they are pieces of one scene"
            )
        if (other := names.setdefault(_stem(path).lower(), path)) != path:
            raise InputError(
                f"{folder}: found {other.name} and {path.name}, one scene in two formats by their names; name the file to read"
            )
    return found


def _stem(path: Path) -> str:
    return re.sub(r"(\.compressed)?\.[A-Za-z]+$", "", path.name)


def _original(path: Path, found: Iterable[Path]) -> Path | None:
    """The file that this one is a copy or a version of, by its name: ``scene (1)`` or ``scene_thin`` of ``scene``."""
    stem = _stem(path).lower()
    copy = re.sub(r"( \(\d+\)|[ _-]+copy[ _-]?\d*)$", "", stem)
    for other in found:
        name = _stem(other).lower()
        if other != path and stem != name and (copy == name or re.match(re.escape(name) + r"[ _.-]+(?!\d+$)", stem)):
            return other
    return None


def _are_iterations(numbers: Iterable[int]) -> bool:
    """Whether numbers are counts of steps, such as 7000 and 30000, or 6999 and 29999, and not of pieces."""
    listed = list(numbers)
    return max(listed) >= 500 and all(n % 100 == 0 or (n + 1) % 100 == 0 for n in listed)


def _iterations(folder: Path) -> dict[int, Path]:
    """The point_cloud.ply of each state of a training output or of its point_cloud folder; none if it is something else."""
    return {
        int(match[1]): file
        for pattern in ("point_cloud/iteration_*/point_cloud.ply", "iteration_*/point_cloud.ply")
        for file in folder.glob(pattern)
        if (match := re.fullmatch(r"iteration_(\d+)", file.parent.name))
    }


def _match(path: Path) -> list[Path]:
    """What a pattern that no shell has expanded stands for."""
    if any(c in str(path) for c in "*?["):
        start = next(folder for folder in path.parents if not any(c in str(folder) for c in "*?["))
        found = sorted(start.glob(path.relative_to(start).as_posix()), key=_natural)
        if found:
            return found
        raise InputError(f"{path}: no file matches this pattern")
    raise InputError(f"{path}: not found; wanted a scene file or folder")


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key by which chunk_9 comes before chunk_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
