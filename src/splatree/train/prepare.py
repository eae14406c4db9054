"""What a run works with: cameras told apart, photographs of the training views alone, the start, the schedule."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatree.constants import NEAR
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.io.cameras.points import Points, read_points
from splatree.io.cameras.split import split_views
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.origin import origin_of
from splatree.shapes import Array, UInt8
from splatree.train.densify import along_curve
from splatree.train.options import DIVISIONS, TrainOptions
from splatree.train.schedule import Schedule, generator
from splatree.train.score import HeldOut
from splatree.train.start import add_apron, extent_of, fill_empty_cells, random_points, start_from
from splatree.train.targets import Targets, coarsest_division, finest_division
from splatree.train.world import World

__all__ = ["Work", "prepare"]

NEAR_EXTENTS = 0.01
"""Nearest depth that is drawn, in extents, where that is less than the usual one."""

ROOTS_SHARE = 16
"""A tree that grows begins with so many times fewer points than it may have leaves: what it begins with is its coarsest level."""


POINTS_SHARE = 0.9
"""Share of the Gaussians that points may take at the start: empty cells, the apron and births need some too."""


@dataclass(frozen=True, eq=False)
class Work:
    """What a run works with."""

    options: TrainOptions
    """How the scene is trained."""
    targets: Targets
    """Photographs of the training views."""
    held_out: HeldOut | None
    """The held-out views; None if there are none, or scores are not asked for."""
    rule: str
    """Which views are held out, and of how many."""
    schedule: Schedule
    """What happens when."""
    world: World
    """Where the scene lies."""
    points: Points
    """Where it starts."""
    notes: tuple[str, ...]
    """What was chosen or left out that the user should know."""
    reading_s: float
    """What it took to read the photographs of the training views for the first step, processor seconds."""

    def start(self) -> Gaussians:
        """The Gaussians that the first step draws, along a Morton curve."""
        rng, room = generator(self.options.seed, "start", 0), self.options.max_gaussians
        share = 1 / ROOTS_SHARE if self.options.levels == "grow" else POINTS_SHARE
        first = max(1, int(share * room))
        gaussians = start_from(self.points, degree=self.options.degree, max_gaussians=first, rng=rng)
        cameras, division = self.targets.cameras, self.schedule.division(0.0)

        def photo_of(i: int) -> UInt8[Array, "h w 3"]:
            return self.targets.at(i, division).photo

        gaussians = fill_empty_cells(gaussians, cameras, photo_of, room=room - len(gaussians))
        if self.options.alpha != "match":  # an object stands before nothing
            gaussians = add_apron(gaussians, cameras, photo_of, room=room - len(gaussians))
        return gaussians.take(along_curve(gaussians))


def prepare(folder: Path, options: TrainOptions, cameras: Path | None) -> Work:
    """Read the cameras and find the photographs of the training views; those of the held-out ones are read for scores alone.

    Raises:
        InputError: there are too few photographs, or none that belong to the cameras, or all were taken at one place; or no pixel
            of them counts, or none of them shows a point.
        FormatError: a file of cameras or points, or a photograph, is damaged.
    """
    views = read_cameras(cameras or folder)
    split = split_views(views.views, options.held_out)
    if len(split.training) < 2:
        raise InputError(
            f"photos: found {len(split.training)} of {len(views)} views to train on, wanted at least 2; hold out fewer, or take "
            "more photographs"
        )
    targets = Targets(folder, split.training, masks=options.masks, alpha=options.alpha)
    if len(targets) < 2:
        raise InputError(
            f"photos: found a photograph of {len(targets)} of the {len(split.training)} training views, wanted at least 2"
        )
    if options.masks is not None and not targets.num_masks:
        raise InputError(
            f"masks: none of the files in {options.masks} is named like one of the {len(targets)} photographs "
            f"({targets.cameras[0].name!r}, ...)"
        )
    extent, notes = extent_of(targets.cameras), list(views.notes)
    points = read_points(folder if cameras is None or (cameras.is_file() and cameras.suffix != ".json") else cameras)
    if points is None:
        notes.append("no points came with the cameras: training begins with random ones, which takes longer")
        points = random_points(targets.cameras, extent, generator(options.seed, "points", 0))
    else:
        _check_seen(points, targets.cameras)
    world, points = _placed(points, extent)
    targets.placed(world.near, np.asarray(world.origin))
    schedule = _schedule(options, targets.cameras)
    targets.check_pixels(schedule.finest)
    begin = time.process_time()
    targets.read_all(schedule.division(0.0))
    reading_s = time.process_time() - begin
    held_out = None
    if options.score and split.held_out:
        held_out = HeldOut(folder, split.held_out, options.masks, options.alpha, schedule.finest, world)
    return Work(options, targets, held_out, split.rule, schedule, world, points, tuple(notes), reading_s)


def _check_seen(points: Points, cameras: Sequence[Camera]) -> None:
    """Refuse points of which no view shows any: they are those of other cameras, or in other coordinates."""
    for camera in cameras:
        x, y, z = camera.camera_from_world[:3, :3] @ points.places.T + camera.camera_from_world[:3, 3:]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            u, v = camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]
        if ((z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)).any():
            return
    raise InputError(
        f"points: found none of {len(points)} in the picture of any of the {len(cameras)} training views, wanted the points of "
        "the same model; cameras and points are in different coordinates, or focal lengths are wrong"
    )


def _placed(points: Points, extent: float) -> tuple[World, Points]:
    """The world whose numbers float32 can hold, and the points in it."""
    sigma = np.full((len(points), 3), np.log(1e-3 * extent), np.float32)
    origin = origin_of(points.places, sigma)
    near = min(NEAR, NEAR_EXTENTS * extent)
    return World(extent, near, origin), replace(points, places=points.places - np.asarray(origin))


def _schedule(options: TrainOptions, cameras: Sequence[Camera]) -> Schedule:
    finest = finest_division(cameras) if options.size is None else DIVISIONS[options.size]
    num_pixels = sum(camera.width * camera.height for camera in cameras)
    return Schedule(options, finest, max(finest, coarsest_division(cameras)), num_pixels)
