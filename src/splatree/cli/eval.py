"""``splatree eval``: what the levels of detail cost in quality and save in work."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.comparison import Drawing, Reporting, compared, in_words
from splatree.cli.console import Console, UsageError, counted, table
from splatree.cli.eval_views import View, means_of, row_of, view_of
from splatree.cli.files import Reading, check_inputs, lost_and_noted, read_scene
from splatree.cli.opening import bytes_of, counts_of, needs_all_rows, opened, sample_of
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.io.cameras.split import split_views
from splatree.io.photos import Photos, PhotosUsed, photographed
from splatree.kernels.devices import DeviceName
from splatree.lod.baselines import Baseline, BaselineName, BaselineOptions, baseline
from splatree.lod.blocks import with_blocks
from splatree.metrics.lpips import Lpips, Net
from splatree.outofcore.store import Store
from splatree.render.calibration import METADATA_KEY
from splatree.render.compare import comparison_views
from splatree.render.compare_page import Comparison
from splatree.render.evaluate import evaluate
from splatree.render.overlap import overlap_hint
from splatree.render.paths import PathOptions, flyout
from splatree.render.timing import STAGES, Timing, check_frames, time_frames
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene


@dataclass(frozen=True)
class Command:
    """Say what was lost: a scene beside another (--reference), the cut beside all leaves, or both beside photographs (--data)."""

    paths: Positional[tuple[Path, ...]]
    """Scene; several files or folders are read as one."""
    reference: Path | None = None
    """Compare with this scene instead, from which the first was made: how much was lost, in PSNR, SSIM and FLIP."""
    report: Path | None = None
    """With --reference: folder for report.html and its pictures, side by side."""
    force: bool = False
    """Replace a report that is there."""
    cameras: Path | None = None
    """cameras.json, transforms.json or a COLMAP model; None: those in --data, or else views that are made for the scene."""
    data: Path | None = None
    """Folder of photographs: the names of the cameras below it, or in its `images` or a scaled copy such as `images_4`."""
    held_out: int | Path = 8
    """With --data: every n-th view was held out of the training (1: all of them), or those named in a text file."""
    training: bool = False
    """With --data: draw the training views too. Their means are kept apart, because they say nothing about new views."""
    every: int = 1
    """Draw each n-th of these views only, from the first."""
    scale: float = 1.0
    """Factor on the width and height of the views; photographs are resized likewise."""
    method: BaselineName | None = None
    """Choose nodes by a published method. Of the options of the selection, only --pixel-error counts then."""
    frames: int = 100
    """Frames timed, the views themselves or a path through them, after 20 to warm up; 0: none."""
    lpips: Net | None = None
    """Also LPIPS by this network; needs the extra `lpips` and its weights."""
    lpips_trunk: Path | None = None
    """Weights of the classifier, from torchvision; None: where torch keeps them."""
    lpips_heads: Path | None = None
    """Weights of LPIPS version 0.1; None: from an installed package lpips or torchmetrics."""
    device: DeviceName = "cpu"
    """Where to select and draw: `cuda` is an NVIDIA GPU; `splatree doctor` says what it needs."""
    max_memory: str | None = None
    """Most memory for what is read of a .splatree or a folder of parts, such as 1G: only what the views need is read. A folder,
    and a .splatree larger than half of the free memory, is always drawn so, unless a baseline or a reference needs all of it; by
    default it takes half of the free memory."""
    made: Annotated[PathOptions, arg(name="", help="")] = PathOptions(views=8)
    select: Annotated[SelectOptions, arg(name="", help="")] = SelectOptions()
    options: Annotated[RenderOptions, arg(name="", help="")] = RenderOptions()
    reading: Annotated[Reading, arg(name="", help="")] = Reading()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Evaluated:
    """What the views say together."""

    num_gaussians: int
    """Leaves of the scene."""
    num_nodes: int
    """All nodes."""
    levels: int
    """Largest depth + 1."""
    method: str
    """How nodes were chosen: the rule of the options, or a published method."""
    select: SelectOptions
    """How the cut was chosen, if by the options."""
    mode: str
    """How the scene was drawn."""
    compared_with: str
    """Photographs and how their views were held out, or all leaves."""
    num_bytes: dict[str, int | None]
    """Gaussians; tree; data of the selection beside it; largest resident memory of the process, with what reading took. Of a
    scene that was not read as a whole, pages in the place of Gaussians and tree."""
    timing: Timing | None
    """Frames along a path; None if none were asked for."""
    mean: dict[str, float | None]
    """Mean of each number over the held-out views, or all views where there are no photographs; means against photographs are
    over the views that have one, those of a PSNR over the views whose pictures differ."""
    training_mean: dict[str, float | None]
    """The same over the training views, if they were drawn."""
    views: tuple[View, ...]
    """One entry a view."""
    photographs: PhotosUsed | None = None
    """Which photographs were used, and which are missing; None if none were given."""
    notes: tuple[str, ...] = ()
    """What the readers of the scene and of the cameras did that the user should know, a sentence each."""


def run(command: Command) -> Evaluated | Comparison:
    """Draw and compare each view, then time frames; with --reference, compare two scenes."""
    check_inputs(command.paths)
    if command.every < 1 or not command.scale > 0:
        raise UsageError(f"every, scale: found {command.every}, {command.scale}, wanted at least 1, and more than 0")
    if command.frames:
        check_frames(command.frames)
    if command.training and command.data is None:
        raise UsageError("training: found no --data, wanted photographs; without them no view is held out")
    if command.data is None and command.held_out != Command.held_out:
        raise UsageError(f"held_out: found {command.held_out} without --data, whose views it tells apart; wanted both")
    if command.lpips is None and (command.lpips_trunk or command.lpips_heads):
        raise UsageError(
            "lpips_trunk, lpips_heads: found weights without --lpips, wanted the name of their network, too"
        )
    if command.reference is not None:
        return _against_reference(command)
    if command.report is not None:
        raise UsageError("report: found no --reference, wanted a scene to compare with")
    source = command.cameras or command.data
    named = None if source is None else read_cameras(source)  # missing ones are told before any work
    whole = [*(["method"] if command.method is not None else []), *needs_all_rows(command.select)]
    with opened(command.paths, command.reading, command.max_memory, whole=whole) as scene:
        return _evaluated(command, scene if isinstance(scene, Store) else with_blocks(scene), named)


def _evaluated(command: Command, drawn_from: Scene | Store, named: Cameras | None) -> Evaluated:
    scene = sample_of(drawn_from)
    cameras = flyout(scene, command.made) if named is None else named.relative_to(scene.source)
    photos = None if command.data is None else Photos(command.data, cameras.views)
    hint = None if named is None else overlap_hint(scene, cameras.views)
    held_out, training, compared_with = _views(cameras.views if photos is None else photos.views, command)
    if photos is not None:
        photos = photos.at([*held_out, *training])
        photographed(held_out, photos, "held-out views")
        _check_calibration(scene, held_out)
        with_photo = sum(camera.name in photos for camera in held_out)
        fewer = "" if with_photo == len(held_out) else f"; {with_photo} of these {len(held_out)} have one"
        compared_with = f"photographs of held-out views, {compared_with}{fewer}"
    select: SelectOptions | Baseline = command.select
    if command.method is not None:
        if command.select.quality is not None:
            raise UsageError("found --quality and --method, wanted one of them: published methods take --pixel-error")
        parameters = BaselineOptions(pixel_error=command.select.pixel_error)
        select = baseline(command.method, scene, training or held_out, parameters)
    network = Lpips(command.lpips, trunk=command.lpips_trunk, heads=command.lpips_heads) if command.lpips else None
    drawn = [*held_out, *training] if command.training else held_out
    compared = evaluate(drawn_from, drawn, command.options, select, photos=photos, lpips=network, device=command.device)
    views = tuple(replace(view_of(evaluation), held_out=i < len(held_out)) for i, evaluation in enumerate(compared))
    timing = None
    if command.frames:
        timing = time_frames(drawn_from, held_out, command.options, select, views=command.frames, device=command.device)
    return Evaluated(
        **counts_of(drawn_from),
        method=command.method or command.select.rule,
        select=command.select,
        mode=command.options.mode or scene.mode,
        compared_with=compared_with,
        num_bytes=bytes_of(drawn_from, select),
        timing=timing,
        mean=means_of([view for view in views if view.held_out]),
        training_mean=means_of([view for view in views if not view.held_out]),
        views=views,
        photographs=None if photos is None else photos.used,
        notes=(*lost_and_noted(scene)[1], *cameras.notes, *([hint] if hint else [])),
    )


def _against_reference(command: Command) -> Comparison:
    """Two scenes from the same views, given or made for the reference."""
    assert command.reference is not None
    if command.data is not None or command.method is not None or command.lpips is not None:
        raise UsageError("reference: found it beside --data, --method or --lpips, wanted one of them")
    Reporting(command.report).check(force=command.force)
    named = None if command.cameras is None else read_cameras(command.cameras)
    scene = read_scene(command.paths, command.reading)
    reference = read_scene([command.reference], command.reading)
    made = comparison_views(reference, command.made) if named is None else named.relative_to(reference.source)
    cameras = made.views[:: command.every]
    return compared(
        scene,
        reference,
        [camera.scaled(command.scale) for camera in cameras],
        command.report,
        about=f"{', '.join(map(str, command.paths))} beside {command.reference}, drawn from the same views",
        force=command.force,
        drawing=Drawing(command.options, command.select, command.device),
    )


def _views(cameras: Sequence[Camera], command: Command) -> tuple[list[Camera], list[Camera], str]:
    """Views to score, training views, and what their pictures are compared with."""

    def chosen(cameras: Sequence[Camera]) -> list[Camera]:
        return [camera.scaled(command.scale) for camera in cameras[:: command.every]]

    if command.data is None:
        return chosen(cameras), [], "pictures of all leaves (no photographs were given)"
    split = split_views(cameras, command.held_out)
    return chosen(split.held_out), chosen(split.training), split.rule


def _check_calibration(scene: Scene, held_out: Sequence[Camera]) -> None:
    """Refuse views on whose photographs τ was chosen: their scores would flatter."""
    calibration = json.loads(scene.source.metadata.get(METADATA_KEY, "{}"))
    seen = set(calibration.get("views", ())) if calibration.get("photographs") else set()
    both = [camera.name for camera in held_out if camera.name in seen]
    if both:
        raise InputError(
            f"held_out: found {both[0]!r} and {len(both) - 1} more among the views that the scene's threshold was calibrated on; "
            "hold out others, or calibrate without them"
        )


def show(evaluated: Evaluated | Comparison, *, verbose: bool = False) -> str:
    """The views as a table, their means, what a frame takes, and sizes."""
    if isinstance(evaluated, Comparison):
        return "\n".join(in_words(evaluated, views=True))
    head = (
        f"{counted(evaluated.num_gaussians, 'Gaussian')}, {counted(evaluated.num_nodes, 'node')}, "
        f"{counted(evaluated.levels, 'level')}, "
        f"{evaluated.mode}, method {evaluated.method}; compared with {evaluated.compared_with}"
    )
    lines = [head, *(f"note: {note}" for note in evaluated.notes)]
    if evaluated.photographs is not None:
        lines += evaluated.photographs.in_words()
    lines += [table([row_of(view, verbose=verbose) for view in evaluated.views]), f"mean: {_words(evaluated.mean)}"]
    if evaluated.training_mean:
        lines.append(f"mean of the training views, no measure of new ones: {_words(evaluated.training_mean)}")
    if evaluated.timing is not None:
        timing = evaluated.timing
        frames = counted(timing.num_frames, "frame")
        lines.append(f"{frames}: {timing.fps:.1f} a second, 95 of 100 at least {timing.fps_p95:.1f}")
        if verbose:
            stages = ", ".join(f"{name} {timing.ms[stage]:.2f}" for name, stage in STAGES.items())
            lines.append(f"ms: {stages}; t_f {timing.filter_ms:.2f}; CPU-ms a frame {timing.frame_cpu_ms:.2f}")
    sizes = {name: number for name, number in evaluated.num_bytes.items() if number is not None}
    lines.append("MiB: " + ", ".join(f"{name} {number / 2**20:,.1f}" for name, number in sizes.items()))
    return "\n".join(lines)


def _words(mean: Mapping[str, float | None]) -> str:
    given = {name: value for name, value in mean.items() if value is not None}
    return ", ".join(
        f"{name} {value:,.0f}" if abs(value) >= 1e3 else f"{name} {value:.4g}" for name, value in given.items()
    )
