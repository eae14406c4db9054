"""Which views are held out: those that a scene was not trained or calibrated on, the only ones that a score may come from.

Two rules are usual: every n-th view in the order in which they are read, from the first (3DGS and most papers: n = 8, ordered by
the pictures' names), or a list of names, which may be a transforms_test.json.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.scene.cameras import Camera

__all__ = ["Split", "split_views"]


@dataclass(frozen=True)
class Split:
    """Views in two parts."""

    held_out: tuple[Camera, ...]
    """Views to score."""
    training: tuple[Camera, ...]
    """Views that the scene may have been trained on."""
    rule: str
    """How they were told apart, in words."""


def split_views(cameras: Sequence[Camera], held_out: int | Path) -> Split:
    """Tell the held-out views from the others.

    ``held_out`` is n for every n-th view from the first, or a text file with one name a line (blank lines and lines from # are
    passed over); names may lack folders and suffix.

    Raises:
        InputError: n is less than 1, or a name is that of no camera or of several.
        FormatError: the file is empty or is not text.
    """
    if isinstance(held_out, Path):
        rows, rule = _listed(cameras, held_out), f"the views listed in {held_out.name}"
    elif held_out < 1:
        raise InputError(f"held_out: found {held_out}, wanted 1 or more (8: every 8th view), or a file of names")
    else:
        rows, rule = set(range(0, len(cameras), held_out)), f"every {_ordinal(held_out)} view from the first"
        if held_out == 1:
            rule = "all views, said to be held out"
    return Split(
        tuple(camera for i, camera in enumerate(cameras) if i in rows),
        tuple(camera for i, camera in enumerate(cameras) if i not in rows),
        f"{rule}: {len(rows)} of {len(cameras)}",
    )


def _names_of_frames(path: Path) -> list[str]:
    """The names of the frames of a transforms_test.json."""
    content = untrusted.as_object(untrusted.read_json(path), str(path))
    frames = untrusted.as_list(untrusted.field(content, "frames", str(path)), f"{path}: frames")
    records = (untrusted.as_object(frame, f"{path}: frame {i}") for i, frame in enumerate(frames))
    return [untrusted.text(record, "file_path", f"{path}: a frame") for record in records]


def _listed(cameras: Sequence[Camera], path: Path) -> set[int]:
    try:
        lines = (
            _names_of_frames(path)
            if path.suffix.lower() == ".json"
            else path.read_text(encoding="utf-8-sig").splitlines()
        )
    except (FileNotFoundError, IsADirectoryError) as error:
        raise InputError(f"{path}: found no such file, wanted a list of the held-out views, one name a line") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not text, wanted one name of a view a line") from error
    names = [name for line in lines if (name := line.strip()) and not name.startswith("#")]
    if not names:
        raise FormatError(f"{path}: found no name, wanted one name of a view a line")
    rows = set()
    for name in names:
        found = [i for i, camera in enumerate(cameras) if camera.name == name]
        found = found or [i for i, c in enumerate(cameras) if PurePosixPath(c.name).stem == PurePosixPath(name).stem]
        if len(found) != 1:
            first = cameras[0].name if cameras else ""
            raise InputError(f"{path}: view {name!r} is the name of {len(found)} cameras, wanted one ({first!r}, ...)")
        rows.add(found[0])
    return rows


def _ordinal(n: int) -> str:
    """2nd, 3rd, 8th, 11th, 21st."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(n % 10, "th") if n % 100 not in (11, 12, 13) else "th"
    return f"{n}{ending}"
