"""``splatree render``: pictures or a video of a scene."""

import re
from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from splatree.cli.console import Console, UsageError, table
from splatree.cli.files import Reading, check_inputs, read_scene
from splatree.errors import InputError, OutputError
from splatree.io.cameras.files import read_cameras
from splatree.io.images import write_image
from splatree.io.replacing import check_target
from splatree.render.batch import trace_batch
from splatree.render.counters import frame_counters, write_counters
from splatree.render.paths import PathOptions, flyout, orbit
from splatree.render.video import check_video, open_video
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.frame import Frame
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import DeviceName, Scene


@dataclass(frozen=True)
class Command:
    """Draw pictures or a video of a scene, from given cameras or along a path made for it."""

    paths: Positional[tuple[Path, ...]]
    """Scene; several files or folders are read as one."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder for the pictures, one PNG a view."""
    video: Path | None = None
    """Video to write (.mp4), of cameras that all have one size; needs the extra `video`."""
    counters: Path | None = None
    """Folder for the work of each cluster and tile, one .npz a view (render/counters.py says what is in it)."""
    fps: float = 30.0
    """Pictures a second in the video."""
    cameras: Path | None = None
    """cameras.json, transforms.json or a COLMAP model; without it a path is made."""
    scale: float = 1.0
    """Factor on the width and height of the cameras."""
    path: Literal["orbit", "flyout"] = "orbit"
    """Path to make without --cameras: around the scene, or away from it."""
    force: bool = False
    """Replace pictures and the video if they exist."""
    device: DeviceName = "cpu"
    """Where to select and draw: `cuda` is an NVIDIA GPU; `splatree doctor` says what it needs."""
    made: Annotated[PathOptions, arg(name="", help="")] = PathOptions()
    select: Annotated[SelectOptions, arg(name="", help="")] = SelectOptions()
    options: Annotated[RenderOptions, arg(name="", help="")] = RenderOptions()
    reading: Annotated[Reading, arg(name="", help="")] = Reading()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class View:
    """One picture."""

    name: str
    """Name of the camera."""
    file: Path | None
    """The picture; None if only a video was written."""
    selected: int
    """Nodes drawn."""
    pairs: int
    """N_P: pairs of splat and tile."""
    pixel_error: float
    """τ_R, px, as raised to meet a budget."""
    ms: dict[str, float]
    """Wall time of each stage."""
    notes: tuple[str, ...] = ()
    """What to know of the selection."""


@dataclass(frozen=True)
class Rendered:
    """What was drawn."""

    output: Path | None
    """Folder of the pictures."""
    video: Path | None
    """The video."""
    counters: Path | None
    """Folder of the counters."""
    views: tuple[View, ...]
    """One entry a picture."""
    notes: tuple[str, ...] = ()
    """What the reader of the cameras chose or left out."""


def run(command: Command) -> Rendered:
    """Draw each view and write it before the next is drawn."""
    check_inputs(command.paths)
    if command.output is None and command.video is None and command.counters is None:
        raise UsageError("found nothing to write, wanted -o FOLDER for pictures, --video FILE.mp4 or --counters FOLDER")
    if not command.scale > 0:
        raise UsageError(f"scale: found {command.scale}, wanted more than 0")
    if command.video is not None:
        check_target(command.video)
        try:
            check_video(command.video, command.fps)
        except InputError as error:
            raise UsageError(str(error)) from error
    named = None if command.cameras is None else read_cameras(command.cameras)
    scene = read_scene(command.paths, command.reading).to(command.device)
    cameras = [camera.scaled(command.scale) for camera in (_made(scene, command) if named is None else named)]
    names = file_names(cameras)
    targets = [command.video] if command.video else []
    for folder, suffix in ((command.output, "png"), (command.counters, "npz")):
        if folder is not None:
            _make_folder(folder)
            targets += [folder / f"{name}.{suffix}" for name in names]
    existing = [target for target in targets if target.exists()]
    if existing and not command.force:
        raise OutputError(f"{existing[0]}: exists already; choose another name or folder, or use --force")
    views = []
    with ExitStack() as stack:
        add = (
            stack.enter_context(open_video(command.video, fps=command.fps, force=command.force))
            if command.video
            else None
        )
        frames = trace_batch(scene, cameras, command.options, command.select)
        for name, frame in zip(names, frames, strict=True):
            file = None
            if command.output is not None:
                file = command.output / f"{name}.png"
                write_image(frame.result.image, file, force=command.force)
            if command.counters is not None:
                counters = frame_counters(scene, frame)
                write_counters(counters, command.counters / f"{name}.npz", force=command.force)
            if add is not None:
                add(frame.result.image)
            views.append(_view(frame, file))
    return Rendered(command.output, command.video, command.counters, tuple(views), named.notes if named else ())


def show(rendered: Rendered) -> str:
    """The views as a table."""
    rows = [
        {"view": view.name, "nodes": view.selected, "pairs": view.pairs}
        | {f"{stage} ms": ms for stage, ms in view.ms.items()}
        for view in rendered.views
    ]
    written = (rendered.output, rendered.video, rendered.counters)
    targets = " and ".join(str(target) for target in written if target)
    said = (*rendered.notes, *(note for view in rendered.views for note in view.notes))
    notes = [f"note: {note}" for note in dict.fromkeys(said)]
    return "\n".join([table(rows), *notes, f"wrote {targets}"])


def _view(frame: Frame, file: Path | None) -> View:
    counters, chosen = frame.result.counters, frame.selection
    return View(
        name=frame.camera.name,
        file=file,
        selected=counters.num_selected,
        pairs=counters.num_pairs,
        pixel_error=chosen.pixel_error,
        ms=frame.result.milliseconds,
        notes=chosen.notes,
    )


def _made(scene: Scene, command: Command) -> Cameras:
    return (orbit if command.path == "orbit" else flyout)(scene, command.made)


def file_names(cameras: Iterable[Camera]) -> list[str]:
    """A file name for each view: its camera's name without folders and suffix, or its number where that is not unique."""
    stems = [re.sub(r"[^\w.-]+", "_", Path(camera.name).stem) for camera in cameras]
    counts = Counter(stems)
    return [stem if stem and counts[stem] == 1 else f"{i:04d}" for i, stem in enumerate(stems)]


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder ({error.strerror})") from error
