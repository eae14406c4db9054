"""What experiments are run on: a scene with levels of detail, views of it, and photographs of these if there are any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from splatree.bench.provenance import machine, program
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.io.cameras.split import split_views
from splatree.io.notes import repairs_in, repairs_in_words
from splatree.io.photos import Photos, photographed
from splatree.io.reading import read
from splatree.lod.blocks import with_blocks
from splatree.render.build import build_lod
from splatree.render.overlap import overlap_hint
from splatree.render.paths import PathOptions, flyout
from splatree.scene.cameras import Camera
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene
from splatree.shapes import Array

__all__ = ["Subject", "SubjectOptions", "subject_of"]

BUNDLED = "semarang_5_9.sog"


@dataclass(frozen=True)
class SubjectOptions:
    """Scene and views of an experiment."""

    scene: tuple[Path, ...] = ()
    """Scene; several files or folders are read as one, levels are built if it has none. Default: the bundled piece of a city."""
    repair: bool = False
    """Fix or drop values of the scene that cannot be used, and count them, instead of stopping."""
    cameras: Path | None = None
    """cameras.json, transforms.json or a COLMAP model; None: those in --data, or else a flight away from the scene."""
    data: Path | None = None
    """Folder of photographs: the names of the cameras below it, or in its `images`; None: pictures are compared with those of all
    leaves."""
    held_out: int | Path = 8
    """With --data: every n-th view is held out, or those named in a text file; only these are drawn and scored."""
    views: int = 6
    """Views drawn, spread evenly over the cameras; 0: all."""
    size: int = 480
    """Width of the pictures, px."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.views < 0:
            raise InputError(f"views: found {self.views}, wanted 0 (all) or more")
        if self.data is None and self.held_out != SubjectOptions.held_out:
            raise InputError(f"held_out: found {self.held_out} without --data, whose views it tells apart; wanted both")
        if self.size < 16:
            raise InputError(f"size: found {self.size}, wanted at least 16 px")


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene and its views, ready."""

    scene: Scene
    """With levels of detail and their block index."""
    cameras: tuple[Camera, ...]
    """Views to draw."""
    training: tuple[Camera, ...]
    """Views that τ may be calibrated on: none of those to draw where photographs make the difference, else the same."""
    photos: Mapping[str, Array] | None
    """Photographs by the camera's name."""
    training_photos: Mapping[str, Array] | None
    """Photographs of the views to calibrate on."""
    about: Mapping[str, str]
    """Scene, cameras, size, comparison, machine and version, in words."""


def subject_of(options: SubjectOptions, *, levels: bool = True, trained: Scene | None = None) -> Subject:
    """Read the scene, build its levels if it has none and ``levels`` are wanted, and choose the views.

    Args:
        options: scene and views.
        levels: whether levels are built.
        trained: a scene in place of the one that the options name.
    """
    scene = _read_scene(options, levels) if trained is None else with_blocks(trained)
    views, training, named, found = _views(scene, options)
    photos, training_photos = (None if found is None else found.at(of) for of in (views, training))
    tree = scene.tree
    nodes = f"{tree.num_leaves:,} Gaussians, {len(tree):,} nodes, {tree.num_levels} levels"
    about = {
        "scene": f"{'trained' if trained else _name(options.scene)}: {nodes}, {scene.mode}",
        **_repaired(scene),
        "cameras": f"{named}, {len(views)} drawn at {views[0].width} × {views[0].height} px",
        "compared with": _comparison(photos),
        "machine": machine(),
        "version": program(),
    }
    return Subject(scene, views, training, photos, training_photos, about)


def _repaired(scene: Scene) -> dict[str, str]:
    """How many values or rows each rule of repair touched, if any."""
    repairs = repairs_in(scene.source.metadata)
    return {"repaired": repairs_in_words(repairs)} if repairs else {}


def _comparison(photos: Photos | None) -> str:
    if photos is None:
        return "pictures of all leaves (no photographs were given)"
    places, *others = photos.used.in_words()
    return "; ".join([f"{len(photos)} photographs ({places.removeprefix('photographs: ')})", *others])


def _views(scene: Scene, options: SubjectOptions) -> tuple[tuple[Camera, ...], tuple[Camera, ...], str, Photos | None]:
    """Views to draw, views to calibrate on, where they are from, and the photographs of all."""

    def chosen(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        return tuple(camera.scaled(options.size / camera.width) for camera in _spread(cameras, options.views))

    source = options.cameras or options.data
    if source is None:
        made = PathOptions(views=options.views or 6, width=options.size, height=options.size * 9 // 16)
        cameras = chosen(flyout(scene, made).views)
        return cameras, cameras, "a flight away from the scene", None
    known = read_cameras(source, source=scene.source)
    hint = overlap_hint(scene, known.views)
    named = "; ".join([source.name, *known.notes, *([hint] if hint else [])])
    if options.data is None:
        return chosen(known.views), chosen(known.views), named, None
    photos = Photos(options.data, known.views)
    split = split_views(photos.views, options.held_out)
    photographed(split.held_out, photos, "held-out views")
    seen, training = ([camera for camera in of if camera.name in photos] for of in (split.held_out, split.training))
    return chosen(seen), chosen(training), f"{named}, {split.rule}", photos


def _read_scene(options: SubjectOptions, levels: bool) -> Scene:
    if options.scene:
        scene = read(options.scene, repair=options.repair)
    else:
        with as_file(files("splatree") / "data" / BUNDLED) as bundled:
            scene = read(bundled)
    return with_blocks(build_lod(scene) if levels and scene.tree.num_levels <= 1 else scene)


def _name(paths: tuple[Path, ...]) -> str:
    if not paths:
        return BUNDLED.removesuffix(".sog")
    return paths[0].name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more"


def _spread(cameras: Sequence[Camera], views: int) -> list[Camera]:
    if not views or views >= len(cameras):
        return list(cameras)
    return [cameras[i] for i in np.linspace(0, len(cameras) - 1, views).round().astype(int)]
