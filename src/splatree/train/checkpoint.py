"""A checkpoint: a file from which a run goes on with the same bits as if it had never stopped.

    scene.run/
      checkpoint.npz   what the next step depends on; what was asked for, and digests of what it is made from

`train` and `refine` keep theirs here. A checkpoint is written beside its place and renamed when it is whole.
"""

import json
import os
import tokenize
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from splatree.errors import FormatError, InputError, OutputError
from splatree.io import untrusted
from splatree.io.replacing import remove_abandoned, replacing
from splatree.shapes import Array

__all__ = [
    "CHECKPOINT",
    "KEPT_AT",
    "CommandName",
    "Identity",
    "check_folder",
    "check_shapes",
    "command_of",
    "load",
    "remove",
    "save",
]

CHECKPOINT = "checkpoint.npz"

KEPT_AT = (0.1, 0.25, 0.5, 0.75)
"""Shares of a run after which it is written down, beside its end."""

VERSION = 3

CommandName = Literal["train", "refine"]

DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    EOFError,
    RuntimeError,
    zipfile.BadZipFile,
    tokenize.TokenError,
)
"""What NumPy's and Python's readers raise where bytes are damaged."""

T = TypeVar("T")


@dataclass(frozen=True)
class Identity:
    """What a run was begun with; a run goes on with the same alone."""

    command: CommandName
    """What the run does."""
    options: Mapping[str, Any]
    """How, as what JSON has."""
    digests: Mapping[str, str]
    """A digest of each thing that the run is made from, by name."""
    thing: str = "input"
    """What these things are called."""
    has_changed: str = "has changed"
    """What is said of one whose digest is another."""
    alike: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    """Values of an option between which a run may go over: they change no step."""


def check_folder(folder: Path, *, resume: bool = False) -> None:
    """Refuse a folder in which no run can be kept, before any work is done. It is made with the first checkpoint.

    Args:
        folder: of the run.
        resume: whether a run goes on that was kept there.

    Raises:
        InputError: there is no run that could go on.
        OutputError: the folder cannot be made, or nothing can be written into it.
    """
    if resume and not (folder / CHECKPOINT).is_file():
        raise InputError(
            f"{folder / CHECKPOINT}: not found; wanted the folder of a run that was begun, or a run from the beginning"
        )
    try:
        folder.lstat()
        place = folder
    except FileNotFoundError:
        place = folder.parent
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder for the run ({error.strerror or error})") from error
    if not place.is_dir():
        raise OutputError(f"{folder}: cannot be made a folder for the run ({place} is no folder)")
    if not os.access(place, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: {place} may not be written into; choose another folder for the run (--run)")


def command_of(folder: Path) -> str | None:
    """The command whose run a folder holds; None: it holds no whole checkpoint."""
    try:
        with (folder / CHECKPOINT).open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return str(json.loads(stored["about"].tobytes())["command"])
    except DAMAGE:
        return None


def save(folder: Path, identity: Identity, arrays: Mapping[str, Array], numbers: Mapping[str, Any]) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        folder: of the run.
        identity: what the run was begun with.
        arrays: what the next step depends on.
        numbers: the same, of what JSON has.

    Raises:
        OutputError: the folder cannot be made, or the disk is full; what was there before is whole.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder for the run ({error.strerror or error})") from error
    remove_abandoned(folder)
    begun_with = {name: getattr(identity, name) for name in ("command", "options")}
    about = {"version": VERSION, **begun_with, "digests": dict(identity.digests), **numbers}
    stored = {**arrays, "about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
    with replacing(folder / CHECKPOINT, force=True) as temporary, temporary.open("wb") as file:
        np.savez(file, **stored)  # type: ignore[arg-type]  # numpy's stub has a flag among the names


def load(folder: Path, identity: Identity, restored: Callable[[Mapping[str, Array], Mapping[str, Any], str], T]) -> T:
    """Read a checkpoint of a run that was begun with the same.

    Args:
        folder: of the run.
        identity: what the run goes on with.
        restored: makes of arrays, numbers and the name of the file what the next step depends on.

    Raises:
        InputError: there is no run, or it was begun with something else.
        FormatError: the checkpoint is damaged.
    """
    path = folder / CHECKPOINT
    check_folder(folder, resume=True)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = untrusted.as_object(json.loads(arrays.pop("about").tobytes()), str(path))
        version = about["version"]
    except DAMAGE as error:
        raise _damaged(path, error) from error
    if version != VERSION:
        raise InputError(f"{path}: found version {version}, wanted {VERSION}; begin the run again")
    _refuse_others(path, about, identity)
    try:
        return restored(arrays, about, str(path))
    except FormatError:
        raise
    except DAMAGE as error:  # among them the InputError of a struct, which knows no file
        raise _damaged(path, error) from error


def check_shapes(arrays: Mapping[str, Array], wanted: Mapping[str, tuple[int, ...]], where: str) -> None:
    """Refuse arrays of a checkpoint that do not belong together.

    Raises:
        FormatError: one has another shape.
    """
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            raise FormatError(f"{where}: {name}: found shape {arrays[name].shape}, wanted {shape}; begin the run again")


def remove(folder: Path) -> None:
    """Remove the checkpoint of a run that has ended, and its folder if nothing else is in it."""
    (folder / CHECKPOINT).unlink(missing_ok=True)
    with suppress(OSError):  # something else is in it, or it is gone
        folder.rmdir()


def _damaged(path: Path, error: Exception) -> FormatError:
    return FormatError(f"{path}: not a whole checkpoint ({error}); begin the run again")


def _refuse_others(path: Path, about: Mapping[str, Any], identity: Identity) -> None:
    command = untrusted.text(about, "command", str(path))
    if command != identity.command:
        raise InputError(f"{path}: found a run of {command}, wanted one of {identity.command}")
    then, digests = (untrusted.as_object(about.get(name), f"{path}.{name}") for name in ("options", "digests"))
    thing = identity.thing
    for name, value in identity.options.items():
        alike = identity.alike.get(name, ())
        if then.get(name) != value and not (then.get(name) in alike and value in alike):
            raise InputError(
                f"{path}: the run was begun with {name} {then.get(name)!r}, found {value!r}; go on with the same options, or "
                "begin a run elsewhere"
            )
    for name, digest in identity.digests.items():
        if digests.get(name) != digest:
            what = "was not there" if name not in digests else identity.has_changed
            raise InputError(
                f"{path}: {thing} {name!r} {what} since the run was begun; go on with the same {thing}s, or begin again"
            )
    gone = [name for name in digests if name not in identity.digests]
    if gone:
        raise InputError(
            f"{path}: {thing} {gone[0]!r}, with which the run was begun, is missing; put it back, or begin again"
        )
