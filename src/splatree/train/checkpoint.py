"""A run on the disk: a folder from which it goes on with the same bits as if it had never stopped.

    scene.run/
      checkpoint.npz   the scene, moments, counters, exposure; options, and digests of the photographs
      log.json         what the clock said: with it the run can be repeated bit for bit
      exposure.json    what each photograph does to colours, 3 × 4

Each file is written beside its place and renamed when it is whole.
"""

import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, InputError, OutputError
from splatree.io import untrusted
from splatree.io.replacing import remove_abandoned, replacing
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import Moments
from splatree.train.densify import Rows, Sightings
from splatree.train.exposure import Exposures
from splatree.train.lineage import Lineage
from splatree.train.options import TrainOptions, plain
from splatree.train.schedule import LogEntry
from splatree.train.score import Score
from splatree.train.state import Scored, State

__all__ = ["CHECKPOINT", "Identity", "load", "make_folder", "read_log", "save"]

CHECKPOINT, LOG, EXPOSURE = "checkpoint.npz", "log.json", "exposure.json"

VERSION = 2

_NOT_ALIKE = ("score",)
"""Options that may differ when a run goes on: they change no bit of the scene."""


@dataclass(frozen=True)
class Identity:
    """What a run was begun with; a run goes on with the same alone."""

    options: TrainOptions
    """How the scene is trained."""
    digests: Mapping[str, str]
    """A digest of each photograph and its camera, by name."""

    @staticmethod
    def of(options: TrainOptions, digests: Mapping[str, str], cameras: Sequence[Camera]) -> "Identity":
        """With the digests of the photographs' files, and of the cameras as they are."""
        found = {}
        for camera in cameras:
            pose = hashlib.blake2b(camera.camera_from_world.tobytes() + camera.K.tobytes(), digest_size=8)
            found[camera.name] = f"{digests[camera.name]} {pose.hexdigest()}"
        return Identity(options, found)


def make_folder(folder: Path) -> None:
    """Make the folder of a run, if it is not there.

    Raises:
        OutputError: it cannot be made, or nothing can be written into it.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder for the run ({error.strerror or error})") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: may not be written into; choose another folder for the run (--run)")


def save(folder: Path, state: State, identity: Identity) -> None:
    """Write a run, whole or not at all.

    Raises:
        OutputError: the folder cannot be made, or the disk is full; what was there before is whole.
    """
    make_folder(folder)
    remove_abandoned(folder)
    about = {
        "version": VERSION,
        "options": plain(identity.options),
        "digests": dict(identity.digests),
        "num_start": state.num_start,
        "step": state.step,
        "loss": state.loss,
        "spent_s": state.spent_s,
        "round_s": state.round_s,
        "log": [asdict(entry) for entry in state.log],
        "history": [asdict(scored) for scored in state.history],
    }
    arrays: dict[str, Any] = {
        **vars(state.rows.gaussians),
        "moments": state.rows.moments.values,
        "steps": state.rows.moments.steps,
        "errors": state.seen.errors,
        "weights": state.seen.weights,
        "exposures": state.exposures.matrices,
        "visits": state.exposures.visits,
        "is_affine": np.array(state.exposures.is_affine),
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
    }
    if (lineage := state.rows.lineage) is not None:
        arrays |= {f"ancestors_{name}": column for name, column in vars(lineage.ancestors).items()}
        arrays |= {"parents": lineage.parents, "of_rows": lineage.of_rows}
    with replacing(folder / CHECKPOINT, force=True) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)
    exposures = dict(zip(identity.digests, state.exposures.relative().tolist(), strict=True))
    for name, content in ((LOG, [asdict(e) for e in state.replay_log]), (EXPOSURE, exposures)):
        with replacing(folder / name, force=True) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def load(folder: Path, identity: Identity) -> State:
    """Read a run that was begun with the same options, photographs and cameras.

    Raises:
        InputError: there is no run, or it was begun with others.
        FormatError: the checkpoint is damaged.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise InputError(f"{path}: not found; wanted the folder of a run that was begun, or a run from the beginning")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(arrays.pop("about").tobytes())
        if about["version"] != VERSION:
            raise InputError(f"{path}: found version {about['version']}, wanted {VERSION}; begin the run again")
        _refuse_others(path, about, identity)
        return _state(arrays, about, str(path))
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError) as error:
        raise FormatError(f"{path}: not a whole checkpoint ({error}); begin the run again") from error


def read_log(path: Path) -> list[LogEntry]:
    """The rounds of an earlier run, from its log.json.

    Raises:
        InputError: there is no such file.
        FormatError: it holds something else.
    """
    if not path.is_file():
        raise InputError(f"{path}: not found; wanted log.json from the folder of a run")
    entries = []
    for i, value in enumerate(untrusted.as_list(untrusted.read_json(path), str(path))):
        where = f"{path}: round {i}"
        record = untrusted.as_object(value, where)
        step, num_steps = untrusted.integer(record, "step", where), untrusted.integer(record, "num_steps", where)
        entries.append(
            LogEntry(
                step, untrusted.number(record, "share", where), untrusted.number(record, "growth", where), num_steps
            )
        )
    expected = 0
    for i, entry in enumerate(entries):
        if not (0 <= entry.share <= 1 and entry.growth >= 0):
            raise FormatError(
                f"{path}: round {i}: found share {entry.share:g} and growth {entry.growth:g}, wanted 0 to 1 that grows"
            )
        if entry.step != expected:
            raise FormatError(f"{path}: round {i}: found its first step {entry.step}, wanted {expected}")
        expected += entry.num_steps
    if expected == 0:
        raise FormatError(f"{path}: found no step in it, wanted the rounds of a run")
    return entries


def _refuse_others(path: Path, about: Mapping[str, Any], identity: Identity) -> None:
    now, then = plain(identity.options), about["options"]
    if "grow" not in (now["levels"], then["levels"]):  # others are built over the trained scene
        then = {**then, "levels": now["levels"]}
    for name, value in now.items():
        if name not in _NOT_ALIKE and then.get(name) != value:
            raise InputError(
                f"{path}: the run was begun with {name} {then.get(name)!r}, found {value!r}; go on with the same options, or "
                "begin a run elsewhere"
            )
    for name, digest in identity.digests.items():
        if about["digests"].get(name) != digest:
            what = "was not there" if name not in about["digests"] else "has changed, or its camera has,"
            raise InputError(
                f"{path}: photograph {name!r} {what} since the run was begun; go on with the same photographs, or begin again"
            )
    gone = [name for name in about["digests"] if name not in identity.digests]
    if gone:
        raise InputError(
            f"{path}: photograph {gone[0]!r}, with which the run was begun, is missing; put it back, or begin again"
        )


def _state(arrays: Mapping[str, Any], about: Mapping[str, Any], where: str) -> State:
    def gaussians(prefix: str = "") -> Gaussians:
        return Gaussians(
            *(np.ascontiguousarray(arrays[prefix + field.name]) for field in dataclasses.fields(Gaussians))
        )

    lineage = None
    if "of_rows" in arrays:
        lineage = Lineage(gaussians("ancestors_"), arrays["parents"], arrays["of_rows"])
    history = [
        Scored(**{**scored, "score": None if scored["score"] is None else Score(**scored["score"])})
        for scored in about["history"]
    ]
    return State(
        Rows(gaussians(), Moments(arrays["moments"], arrays["steps"]), lineage),
        Sightings(arrays["errors"], arrays["weights"]),
        Exposures(arrays["exposures"], arrays["visits"], bool(arrays["is_affine"])),
        num_start=untrusted.integer(about, "num_start", where),
        step=untrusted.integer(about, "step", where),
        loss=untrusted.number(about, "loss", where),
        spent_s=untrusted.number(about, "spent_s", where),
        round_s=untrusted.number(about, "round_s", where),
        log=[LogEntry(**entry) for entry in about["log"]],
        history=history,
    )
