"""Train a scene from photographs: the loop around the steps, with its clock, its scores and its checkpoints.

    cameras ─► held-out views | training views ─► targets ─► start ─► [ step … densify ]* ─► Scene

A run is deterministic: with the same photographs, options and log it leaves the same bits, for any number of threads, and whether
it was interrupted or not. Only the log depends on the clock, and with ``iterations`` even that does not.
"""

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from splatree.io.photos import PhotosUsed
from splatree.kernels.devices import DeviceName, training_stages_of
from splatree.lod.options import BuildOptions
from splatree.progress import task
from splatree.render.build import build_lod
from splatree.scene.arguments import checked
from splatree.scene.given import check_threads, given
from splatree.scene.scene import NEAR_KEY, Scene, Source
from splatree.shapes import Array, Float64
from splatree.train.checkpoint import KEPT_AT, check_folder
from splatree.train.densify import Rows, Sightings, densified
from splatree.train.exposure import Exposures
from splatree.train.kept import identity_of, load_state, read_log, save_state
from splatree.train.lineage import Lineage
from splatree.train.options import RunFiles, TrainOptions, plain
from splatree.train.prepare import Work, prepare
from splatree.train.schedule import BIRTHS_END, ROUND, LogEntry, generator, rates, round_of
from splatree.train.state import Scored, State
from splatree.train.step import Drawing, learn

__all__ = ["METADATA_KEY", "Trained", "train"]

METADATA_KEY = "training"
"""Where a scene says how it was trained, in ``source.metadata``."""

EXPOSURE_BEGINS = 0.1
"""Share of the run from which exposure is told apart: before, pictures say little about it."""

LOSS_MEMORY = 0.98
"""Weight of the past in the running mean of the loss."""


@dataclass(frozen=True, eq=False)
class Trained:
    """A trained scene, and how it came about.

    Example:
        >>> trained = st.train("photographs", st.TrainOptions(iterations=2, max_gaussians=100))
        >>> len(trained.scene) <= 100, trained.stopped
        (True, False)
    """

    scene: Scene
    """The scene, with levels if they were asked for; ``source.metadata["training"]`` says how it was trained."""
    history: tuple[Scored, ...]
    """The scene after 10, 25, 50 and 75 % of the run and at its end."""
    exposures: dict[str, Float64[Array, "3 4"]]
    """What each photograph does to the colours of the scene: Y = M X + b, with M in the first three columns and b in the last.
    Gains have but a diagonal, and a geometric mean of 1; the mean of affine ones is the identity."""
    log: tuple[LogEntry, ...]
    """What the clock said; with it the run can be repeated bit for bit."""
    rule: str
    """Which views were held out, and of how many."""
    photographs: PhotosUsed
    """Which photographs were found."""
    stopped: bool = False
    """Whether the run was stopped before its end."""
    notes: tuple[str, ...] = ()
    """What was chosen or left out that the user should know, a sentence each."""


@checked
def train(
    photos: str | os.PathLike[str],
    options: TrainOptions | None = None,
    *,
    cameras: str | os.PathLike[str] | None = None,
    files: RunFiles | None = None,
    stop: Callable[[], bool] = lambda: False,
    watch: Callable[[Scored], None] = lambda scored: None,
    device: DeviceName = "cpu",
    threads: int = 0,
) -> Trained:
    """Train a scene from photographs whose cameras are known.

    Args:
        photos: folder of photographs, with a COLMAP model, transforms.json or cameras.json.
        options: how; None: for ten processor minutes.
        cameras: cameras from elsewhere; None: those in the folder.
        files: where checkpoints of the run are kept; None: nowhere.
        stop: asked after each step; True ends the run there, with a checkpoint.
        watch: called with each score, as the run goes on.
        device: where steps are computed, `cpu`, `cuda` or `reference`. A run gives the same bits again on the same device.
        threads: threads to use; 0: all. The result is the same for any number, at equal steps.

    Returns:
        The scene with its history.

    Raises:
        InputError: there are too few photographs, or none that belong to the cameras; or a run cannot go on.
        FormatError: a file of cameras, a photograph or a checkpoint is damaged.
        OutputError: a checkpoint cannot be written; the last one is whole.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example:
        >>> trained = st.train("photographs", st.TrainOptions(iterations=2, max_gaussians=200))
        >>> st.write(trained.scene, "trained.splatree")
        ()
    """
    options, files = given(options, TrainOptions, "train: options"), given(files, RunFiles, "train: files")
    check_threads(threads)
    if files.folder is not None:
        check_folder(files.folder, resume=files.resume)
    drawing = Drawing(training_stages_of(device), options.mode, 1, threads)
    work = prepare(Path(photos), options, None if cameras is None else Path(cameras))
    identity = identity_of(options, work.targets.digests(), work.targets.cameras)
    earlier = [] if files.replay is None else read_log(files.replay)
    if files.resume:
        assert files.folder is not None  # RunFiles holds to it
        state = load_state(files.folder, identity)
    else:
        state = _beginning(work)
    stopped = False
    with task("train", 1.0) as advance:
        advance(state.share)
        for due in _rounds(work, state, earlier):
            before = state.share
            stopped = _round(work, state, due, drawing, stop)
            advance(state.share - before)
            is_whole = state.step == due.step + due.num_steps
            if is_whole and not _is_done(work, state, earlier) and state.share >= _next_mark(state):
                _keep(work, state, drawing, watch)
                if files.folder is not None:
                    save_state(files.folder, state, identity)
            if stopped:
                break
    if not stopped and not (state.history and state.history[-1].iterations == state.step):
        _keep(work, state, drawing, watch, is_end=True)
    if files.folder is not None:
        save_state(files.folder, state, identity)
    return _trained(work, state, Path(photos), stopped, threads)


def _beginning(work: Work) -> State:
    """The state before the first step; making it, and reading the photographs for it, is part of the run's time."""
    begin = time.process_time()
    gaussians = work.start()
    n, num_photos = len(gaussians), len(work.targets)
    rows = Rows.beginning(gaussians)
    if work.options.levels == "grow":
        rows = replace(rows, lineage=Lineage.none(gaussians))
    state = State(
        rows, Sightings.none(n), Exposures.none(num_photos, is_affine=work.options.exposure == "affine"), num_start=n
    )
    state.spent_s = work.reading_s + time.process_time() - begin
    return state


def _rounds(work: Work, state: State, earlier: Sequence[LogEntry]) -> Iterator[LogEntry]:
    """The rounds that are due, one after the other; one that was interrupted goes on first."""
    if state.log and state.step < state.log[-1].step + state.log[-1].num_steps:
        yield state.log[-1]
    while not _is_done(work, state, earlier):
        last = state.log[-1] if state.log else None
        state.log.append(round_of(work.options, state.step, state.spent_s, last, state.round_s, earlier))
        state.round_s = 0.0
        yield state.log[-1]


def _is_done(work: Work, state: State, earlier: Sequence[LogEntry]) -> bool:
    if earlier:
        return state.step >= earlier[-1].step + earlier[-1].num_steps
    if work.options.budget_s is None:
        assert work.options.iterations is not None
        return state.step >= work.options.iterations
    return state.spent_s >= work.options.budget_s


def _round(work: Work, state: State, due: LogEntry, drawing: Drawing, stop: Callable[[], bool]) -> bool:
    """Make the steps of a round that are left; whether it was stopped."""
    while state.step < due.step + due.num_steps:
        begin = time.process_time()
        _step(work, state, drawing)
        took = time.process_time() - begin
        state.spent_s += took
        state.round_s += took
        if stop():
            return True
    return False


def _step(work: Work, state: State, drawing: Drawing) -> None:
    """One photograph, and what is due after it."""
    share, extent = state.share, work.world.extent
    i = work.schedule.view(state.step, len(work.targets))
    division = work.schedule.division(share)
    target = work.targets.at(i, division)
    now = rates(share, extent, state.rows.moments, state.rows.gaussians.sh.shape[1])
    sh_degree, times_smaller = work.schedule.sh_degree(share), work.schedule.times_smaller(share)
    drawing = replace(drawing, sh_degree=sh_degree, times_smaller=times_smaller)
    loss, image = learn(state.rows, state.seen, target, state.exposures.of(i), now, extent, drawing)
    if work.options.exposure != "none" and share >= EXPOSURE_BEGINS:
        state.exposures.visit(i, loss, image, target.photo, target.mask)
    memory = LOSS_MEMORY if state.step else 0.0
    state.loss = memory * state.loss + (1 - memory) * loss.value
    state.step += 1
    if state.step % ROUND == 0 and share < BIRTHS_END:
        count = work.schedule.count_target(share, state.num_start)
        rng = generator(work.options.seed, "births", state.step)
        state.rows = densified(state.rows, state.seen, count, extent, rng)
        state.seen = Sightings.none(len(state.rows.gaussians))
        work.targets.drop_others(division)


def _keep(work: Work, state: State, drawing: Drawing, watch: Callable[[Scored], None], *, is_end: bool = False) -> None:
    """Add the scene as it is, scored at the finest size, to the history."""
    score, gaussians = None, state.rows.gaussians
    if work.held_out is not None:
        drawing = replace(drawing, sh_degree=work.schedule.sh_degree(1.0))
        score = work.held_out.score(gaussians, drawing)
    share = 1.0 if is_end else state.share
    state.history.append(Scored(share, state.step, state.spent_s, len(gaussians), state.loss, score))
    watch(state.history[-1])


def _next_mark(state: State) -> float:
    """The share at which the run is scored and written down next, before its end."""
    done = state.history[-1].share if state.history else 0.0
    return next((mark for mark in KEPT_AT if mark > done), float("inf"))


def _trained(work: Work, state: State, folder: Path, stopped: bool, threads: int) -> Trained:
    """What the run leaves."""
    last = None if stopped or not state.history else state.history[-1].score
    record = {
        "options": plain(work.options),
        "photographs": len(work.targets),
        "held_out": work.rule,
        "division": work.schedule.finest,
        "extent": work.world.extent,
        "iterations": state.step,
        "cpu_minutes": round(state.spent_s / 60, 4),
        "stopped": stopped,
        "score": None if last is None else asdict(last),
    }
    metadata = {METADATA_KEY: json.dumps(record), NEAR_KEY: str(work.world.near)}
    source = Source((str(folder),), "photographs", metadata, work.world.origin)
    scene, levels = Scene.flat(state.rows.gaussians, mode=work.options.mode, source=source), work.options.levels
    if state.rows.lineage is not None:
        scene = state.rows.lineage.tree(scene)
    elif levels == "radius" or levels == "pairs":
        scene = build_lod(scene, BuildOptions(method=levels), threads=threads)
    return Trained(
        scene,
        tuple(state.history),
        dict(zip([camera.name for camera in work.targets.cameras], state.exposures.relative(), strict=True)),
        tuple(state.replay_log),
        work.rule,
        work.targets.used,
        stopped,
        (*work.notes, *(work.held_out.notes if work.held_out is not None else ())),
    )
