"""A training on the disk: its state as arrays and numbers of a checkpoint, and two files for others.

    scene.run/
      checkpoint.npz   the scene, moments, counters, exposure (train/checkpoint.py)
      log.json         what the clock said: with it the run can be repeated bit for bit
      exposure.json    what each photograph does to colours, 3 × 4

Each file is written beside its place and renamed when it is whole.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, InputError
from splatree.io import untrusted
from splatree.io.replacing import replacing
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import Moments
from splatree.shapes import Array
from splatree.train.checkpoint import Identity, check_shapes, load, save
from splatree.train.densify import Rows, Sightings
from splatree.train.exposure import Exposures
from splatree.train.lineage import Lineage
from splatree.train.options import TrainOptions, plain
from splatree.train.schedule import LogEntry
from splatree.train.score import Score
from splatree.train.state import Scored, State

__all__ = ["identity_of", "load_state", "read_log", "save_state"]

LOG, EXPOSURE = "log.json", "exposure.json"

_ALIKE = {"score": (False, True), "levels": ("none", "radius", "pairs")}
"""Levels other than those that grow are built over the trained scene."""


def identity_of(options: TrainOptions, digests: Mapping[str, str], cameras: Sequence[Camera]) -> Identity:
    """What a training is begun with: options, the photographs' files by their digests, and the cameras as they are."""
    found = {}
    for camera in cameras:
        pose = hashlib.blake2b(camera.camera_from_world.tobytes() + camera.K.tobytes(), digest_size=8)
        found[camera.name] = f"{digests[camera.name]} {pose.hexdigest()}"
    changed = "has changed, or its camera has,"
    return Identity("train", plain(options), found, thing="photograph", has_changed=changed, alike=_ALIKE)


def save_state(folder: Path, state: State, identity: Identity) -> None:
    """Write a training, each file whole or not at all.

    Raises:
        OutputError: the folder cannot be made, or the disk is full; what was there before is whole.
    """
    numbers = {
        "num_start": state.num_start,
        "step": state.step,
        "loss": state.loss,
        "spent_s": state.spent_s,
        "round_s": state.round_s,
        "log": [asdict(entry) for entry in state.log],
        "history": [asdict(scored) for scored in state.history],
    }
    arrays: dict[str, Array] = {
        **vars(state.rows.gaussians),
        "moments": state.rows.moments.values,
        "steps": state.rows.moments.steps,
        "errors": state.seen.errors,
        "weights": state.seen.weights,
        "exposures": state.exposures.matrices,
        "visits": state.exposures.visits,
        "is_affine": np.array(state.exposures.is_affine),
    }
    if (lineage := state.rows.lineage) is not None:
        arrays |= {f"ancestors_{name}": column for name, column in vars(lineage.ancestors).items()}
        arrays |= {"parents": lineage.parents, "of_rows": lineage.of_rows}
    save(folder, identity, arrays, numbers)
    exposures = dict(zip(identity.digests, state.exposures.relative().tolist(), strict=True))
    for name, content in ((LOG, [asdict(e) for e in state.replay_log]), (EXPOSURE, exposures)):
        with replacing(folder / name, force=True) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def load_state(folder: Path, identity: Identity) -> State:
    """Read a training that was begun with the same options, photographs and cameras.

    Raises:
        InputError: there is no run, or it was begun with others.
        FormatError: the checkpoint is damaged.
    """
    return load(folder, identity, partial(_state, num_photos=len(identity.digests)))


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


def _state(arrays: Mapping[str, Any], about: Mapping[str, Any], where: str, *, num_photos: int) -> State:
    def gaussians(prefix: str = "") -> Gaussians:
        return Gaussians(
            *(np.ascontiguousarray(arrays[prefix + field.name]) for field in dataclasses.fields(Gaussians))
        )

    rows, lineage = gaussians(), None
    n, p = len(rows), num_photos
    moments = Moments.zeros(n, rows.sh.shape[1]).values.shape
    wanted = {"moments": moments, **dict.fromkeys(("steps", "errors", "weights"), (n,))}
    check_shapes(arrays, wanted | {"exposures": (p, 3, 4), "visits": (p,)}, where)
    if "of_rows" in arrays:
        check_shapes(arrays, {"of_rows": (n,)}, where)
        lineage = Lineage(gaussians("ancestors_"), arrays["parents"], arrays["of_rows"])
    history = [
        Scored(**{**scored, "score": None if scored["score"] is None else Score(**scored["score"])})
        for scored in about["history"]
    ]
    return State(
        Rows(rows, Moments(arrays["moments"], arrays["steps"]), lineage),
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
