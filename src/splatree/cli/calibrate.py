"""``splatree calibrate``: choose τ, the opacity at which splats end, and keep it in the scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from splatree.cli.console import Console, UsageError, counted, table
from splatree.cli.files import Files, inputs_and_output
from splatree.cli.opening import needs_all_rows, opened, sample_of
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.io.cameras.split import split_views
from splatree.io.formats.folder.manifest import MANIFEST, checked_path, read_manifest
from splatree.io.inputs import check_are_there
from splatree.io.objects import located
from splatree.io.photos import Photos, PhotosUsed, photographed
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.outofcore.crown import replace_crown
from splatree.render.calibrate import calibrate
from splatree.render.calibration import CalibrateOptions, Calibration, calibrated
from splatree.render.overlap import overlap_hint
from splatree.render.paths import PathOptions, flyout, orbit
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene


@dataclass(frozen=True)
class Views:
    """Views to calibrate with; those held out for scores are never used."""

    cameras: Path | None = None
    """Calibrate with these views: cameras.json, transforms.json or a COLMAP model; None: those in --data."""
    data: Path | None = None
    """Folder of photographs: the names of the cameras below it, or in its `images` or a scaled copy such as `images_4`."""
    held_out: int | Path = 8
    """Leave out the views kept for scores: each n-th from the first, or a file of names, one a line."""
    scale: float = 1.0
    """Factor on the width and height of the views; photographs are resized likewise."""

    def __post_init__(self) -> None:
        if not self.scale > 0:
            raise InputError(f"scale: found {self.scale}, wanted more than 0")


@dataclass(frozen=True)
class TrainingViews:
    """What `Views` name."""

    cameras: Sequence[Camera]
    """The views that are not held out."""
    photos: Photos | None
    """Their photographs, if a folder was given."""
    rule: str
    """Which views were left out, and of how many."""
    notes: tuple[str, ...] = ()
    """What the reader of the cameras chose or left out."""

    def relative_to(self, scene: Scene) -> "TrainingViews":
        """The same views in the coordinates of a scene, and a note if none of them sees it."""
        cameras = Cameras(tuple(self.cameras)).relative_to(scene.source).views
        hint = overlap_hint(scene, cameras)
        return replace(self, cameras=cameras, notes=(*self.notes, *([hint] if hint else [])))

    @property
    def used(self) -> PhotosUsed | None:
        """Which photographs were used."""
        return None if self.photos is None else self.photos.used


@dataclass(frozen=True)
class Command:
    """Choose the τ of a scene and keep it: in.splatree out.splatree; with one path, a .splatree is changed in place.

    A folder of parts that is changed in place is drawn page by page.
    """

    files: Annotated[Files, arg(name="", help="")]
    max_memory: str | None = None
    """Of a folder of parts in place: what the pages that are kept may take, such as 500M; None: half of what is free."""
    views: Annotated[Views, arg(name="", help="")] = Views()
    path: Literal["orbit", "flyout"] = "flyout"
    """Path to make without --cameras and --data: `orbit` around the scene, or `flyout` away from it."""
    made: Annotated[PathOptions, arg(name="", help="")] = PathOptions(views=16)
    calibration: Annotated[CalibrateOptions, arg(name="", help="")] = CalibrateOptions()
    select: Annotated[SelectOptions, arg(name="", help="")] = SelectOptions()
    options: Annotated[RenderOptions, arg(name="", help="")] = RenderOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Calibrated:
    """What was chosen, and where it was written."""

    output: Path
    """The file."""
    held_out: str
    """Which views were left out, and of how many; empty for views made for the scene."""
    calibration: Calibration
    """τ, how it was chosen, and what it costs and saves."""
    photographs: PhotosUsed | None = None
    """Which photographs were used, and which are missing; None if none were given."""
    notes: tuple[str, ...] = ()
    """What the reader of the cameras chose or left out."""


def run(command: Command) -> Calibrated:
    """Read, draw, choose, write."""
    paths = tuple(map(located, command.files.paths))
    in_place = command.files.output is None and len(paths) == 1 and paths[0].suffix.lower() == ".splatree"
    inputs, output = (paths, paths[0]) if in_place else inputs_and_output(command.files, keeps_tree=True)
    views = training_views(command.views)
    is_folder = in_place and (output / MANIFEST).exists()
    if command.max_memory is not None and not is_folder:
        check_are_there(inputs)
        raise UsageError(
            f"max_memory: found {', '.join(map(str, inputs))}, wanted one folder of parts, which is changed in place; other "
            "scenes are written whole, from memory"
        )
    whole = needs_all_rows(command.select) if is_folder else ["output"]
    with opened(inputs, command.files.reading, command.max_memory, whole=whole) as scene:
        if views is not None:
            views = views.relative_to(sample_of(scene))
        else:
            made = {"orbit": orbit, "flyout": flyout}[command.path](sample_of(scene), command.made)
            views = TrainingViews(list(made), None, "")
        calibration = calibrate(
            scene, views.cameras, command.calibration, command.options, command.select, photos=views.photos
        )
    held_out = views.rule or f"none: {command.path} made for the scene"
    if is_folder:
        crown = read(checked_path(output, read_manifest(output).crown))
        replace_crown(output, calibrated(crown, calibration, held_out=held_out))
    else:
        assert isinstance(scene, Scene)  # a store is opened of a folder alone
        kept = calibrated(scene, calibration, held_out=held_out)
        write(kept, output, force=in_place or command.files.force)
    return Calibrated(output, views.rule, calibration, views.used, views.notes)


def training_views(views: Views) -> TrainingViews | None:
    """The views to calibrate with; None if neither cameras nor photographs are named.

    Raises:
        InputError: they cannot be read, or all of them are held out.
    """
    source = views.cameras or views.data
    if source is None:
        for name in ("held_out", "scale"):
            if getattr(views, name) != getattr(Views, name):
                raise UsageError(
                    f"{name}: found {getattr(views, name)} without --cameras or --data, whose views it is for"
                )
        return None
    cameras = read_cameras(source)
    photos = Photos(views.data, cameras.views) if views.data else None
    split = split_views(cameras.views if photos is None else photos.views, views.held_out)
    if not split.training:
        raise InputError(f"held_out: found {views.held_out}, which leaves no view to calibrate with; wanted 2 or more")
    training = [camera.scaled(views.scale) for camera in split.training]
    if photos is not None:
        photos = photos.at(training)
        photographed(training, photos, "views to calibrate with")
    return TrainingViews(training, photos, split.rule, cameras.notes)


def show(calibrated: Calibrated) -> str:
    """The result in words."""
    c = calibrated.calibration
    rows = [
        {
            "τ": f"{trial.threshold:.5f}",
            "loss dB": f"{trial.loss_db:.4f}",
            "worst view dB": f"{trial.worst_loss_db:.4f}",
            "PSNR to lossless": "" if trial.psnr is None else f"{trial.psnr:.2f}",
            "pairs": trial.num_pairs,
            "of lossless": f"{trial.num_pairs / max(1, c.num_pairs_lossless):.3f}",
        }
        for trial in sorted(c.trials, key=lambda trial: trial.threshold)
    ]
    left_out = f"; held out: {calibrated.held_out}" if calibrated.held_out else ""
    return (
        f"{table(rows)}\n"
        f"G = {c.contribution:.4g} ({c.options.unit}, {c.options.tiles} tiles, lists {c.options.lists}) over "
        f"{counted(len(c.views), 'view')} of {c.size_px[0]} × {c.size_px[1]} px{left_out}\n"
        + "\n".join(
            [*views_in_words(calibrated.photographs, calibrated.notes), in_words(c), f"kept in {calibrated.output}"]
        )
    )


def views_in_words(photographs: PhotosUsed | None, notes: Sequence[str]) -> list[str]:
    """What the user should know of the views: which model, which photographs."""
    return [*(f"note: {note}" for note in notes), *(photographs.in_words() if photographs else [])]


def in_words(c: Calibration) -> str:
    """τ, how it was chosen, what it costs and saves."""
    truth = (
        "the photographs" if c.photographs else f"a truth that lossless pictures are {c.options.scene_psnr:g} dB from"
    )
    others = f"1 in {len(c.views) + 1} other views like these loses more"
    worst = f"{c.worst_loss_db:.3f} dB in the worst view ({c.worst_view}; {others}), " if c.worst_view else ""
    return (
        f"τ = {c.threshold:.5f} ({c.tile_rule}, {c.pixels}) by {c.policy}: {c.loss_db:.3f} dB lost against {truth}, {worst}"
        f"{c.num_pairs / max(1, c.num_pairs_lossless):.3f} × the pairs of lossless"
    )
