"""``splatree render``: pictures or a video of a scene."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import Console, UsageError, table
from splatree.cli.files import Reading, check_inputs, lost_and_noted, read_scene
from splatree.cli.opening import needs_all_rows, opened, sample_of
from splatree.cli.pictures import (
    PlaneSuffix,
    Targets,
    file_names,
    is_picture,
    make_folder,
    refuse_existing,
    remove_stale,
    targets_of,
)
from splatree.cli.viewpoint import Viewpoint, Views, named_views, relative_to, views_of
from splatree.errors import InputError
from splatree.io.cut import level_of
from splatree.io.registry import detect
from splatree.kernels.devices import DeviceName
from splatree.outofcore.store import Store
from splatree.progress import track
from splatree.render.batch import trace_batch
from splatree.render.counters import frame_counters, write_counters
from splatree.render.moving import MovedFrame
from splatree.render.paths import PathOptions
from splatree.render.session import open_session
from splatree.render.video import check_video, open_video
from splatree.scene.frame import Frame, RenderResult
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import Wanted

TURNTABLE_VIEWS = 120
"""Views of --turntable if --views does not say: four seconds at 30 a second."""


@dataclass(frozen=True)
class Command:
    """Draw pictures or a video of a scene, from given cameras or from where it looks best.

    Without -o, one picture is written beside you: city.ply becomes city.png. -o pic.png names it; -o FOLDER writes all views.
    """

    paths: Positional[tuple[Path, ...]]
    """Scene; several files or folders are read as one."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """One picture (.png), or a folder for one picture a view."""
    turntable: Path | None = None
    """Video (.mp4) of one turn around the scene, or around within it; needs the extra `video`."""
    video: Path | None = None
    """Video to write (.mp4), of the views that are drawn; needs the extra `video`."""
    fps: float = 30.0
    """Pictures a second in the video."""
    viewpoint: Annotated[Viewpoint, arg(name="", help="")] = Viewpoint()
    level: int | None = None
    """Draw one level of detail: 0 is the finest, the one above it comes next."""
    depth: PlaneSuffix | None = None
    """Also write the depth of each pixel: `exr` in world units, `png` in steps that the file names (16 bits)."""
    alpha: PlaneSuffix | None = None
    """Also write the share of light that the scene stops at each pixel, in the same ways."""
    counters: Path | None = None
    """Folder for the work of each cluster and tile, one .npz a view (render/counters.py says what is in it)."""
    force: bool = False
    """Replace pictures and videos if they exist, and remove pictures of an earlier run from the folder."""
    device: DeviceName = "cpu"
    """Where to select and draw: `cuda` is an NVIDIA GPU; `splatree doctor` says what it needs."""
    max_memory: str | None = None
    """Most memory for what is read of a .splatree or a folder of parts, such as 1G: only what the views need is read. A folder,
    and a .splatree larger than half of the free memory, is always drawn so; by default it takes half of the free memory."""
    moving: bool = False
    """Draw the views as those of a camera that moves, several times faster: cuts and colours are kept while it moves little, and
    there is no depth. What viewers show until the camera is still."""
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
    """The picture, or the folder of the pictures."""
    video: Path | None
    """The video."""
    counters: Path | None
    """Folder of the counters."""
    views: tuple[View, ...]
    """One entry a picture."""
    reasons: tuple[str, ...] = ()
    """How the views were chosen, a sentence each; none for given cameras."""
    num_removed: int = 0
    """Pictures of an earlier run that were removed from the folder."""
    notes: tuple[str, ...] = ()
    """What the readers of the scene and of the cameras did that the user should know, a sentence each."""


def run(command: Command) -> Rendered:
    """Draw each view and write it before the next is drawn."""
    check_inputs(command.paths)
    if command.moving and (command.depth or command.counters):
        raise UsageError(
            "moving: found beside --depth or --counters, which only exact pictures have; leave out one of them"
        )
    video = _video(command)
    output = _output(command, video)
    named = named_views(command.viewpoint)
    if output is not None and is_picture(output):
        refuse_existing([output], force=command.force)
    with _scene(command) as scene:
        return _run(command, scene, output, video, named)


def _run(
    command: Command, scene: Scene | Store, output: Path | None, video: Path | None, named: Views | None
) -> Rendered:
    made, sample = command.made, sample_of(scene)
    if command.turntable is not None and made.views == PathOptions().views:
        made = replace(made, views=TURNTABLE_VIEWS)
    views = relative_to(named, sample) if named else views_of(sample, command.viewpoint, made)
    if output is not None and is_picture(output) and video is None:
        others = f"the first of {len(views.cameras)} views is drawn; --view N draws another, -o FOLDER all of them"
        notes = (others,) if named and len(views.cameras) > 1 else ()
        views = replace(views, cameras=views.cameras[:1], notes=(*views.notes, *notes))
    targets = targets_of(file_names(views.cameras), output, command.counters, depth=command.depth, alpha=command.alpha)
    for folder in (output if output and not is_picture(output) else None, command.counters):
        if folder is not None:
            make_folder(folder)
    refuse_existing([path for target in targets for path in target.paths], force=command.force)
    drawn = _drawn(command, scene, views, targets, video)
    removed = 0
    if command.force and output is not None and not is_picture(output):
        removed = remove_stale(output, [path for target in targets for path in target.paths])
    return Rendered(
        output, video, command.counters, drawn, views.reasons, removed, (*lost_and_noted(sample)[1], *views.notes)
    )


def _video(command: Command) -> Path | None:
    """The video to write, checked."""
    if command.turntable is not None and (command.video is not None or command.viewpoint.cameras is not None):
        other = "--video" if command.video is not None else "--cameras"
        raise UsageError(f"turntable: found beside {other}, wanted one of them; --video follows cameras")
    if command.turntable is not None and command.viewpoint.view is not None:
        raise UsageError("turntable: found beside --view, wanted all views; -o pic.png --view N draws one")
    video = command.turntable or command.video
    if video is not None:
        try:
            check_video(video, command.fps)
        except InputError as error:
            raise UsageError(str(error)) from error
        refuse_existing([video], force=command.force)
    return video


def _output(command: Command, video: Path | None) -> Path | None:
    """The picture or the folder; where nothing at all is named, a picture named like the scene."""
    output = command.output
    if output is None and video is None and command.counters is None:
        output = Path(f"{_name_of(command.paths[0])}.png")
    if output is None and (command.depth or command.alpha):
        raise UsageError("depth, alpha: found no -o, wanted a picture or a folder to write them beside")
    if output is not None and not is_picture(output) and output.suffix and not output.is_dir() and command.output:
        suffix = output.suffix.lower()
        if suffix in (".jpg", ".jpeg", ".webp", ".exr", ".bmp", ".tif", ".tiff", ".gif", ".mp4"):
            wanted = "--video for an .mp4" if suffix == ".mp4" else "a picture (.png) or a folder"
            raise UsageError(f"{output}: found suffix {output.suffix!r}, wanted {wanted}")
    return output


def _name_of(path: Path) -> str:
    """city for city.ply, city.compressed.ply and city/."""
    if not path.is_file():
        return path.resolve().name or "scene"
    return path.name.removesuffix(path.suffix).removesuffix(".compressed") or "scene"


@contextmanager
def _scene(command: Command) -> Iterator[Scene | Store]:
    """The scene, or one level of it, or a store."""
    level, one = command.level, len(command.paths) == 1
    if level is not None and one and (found := detect(command.paths[0])) is not None and found.holds.levels == "one of":
        yield read_scene(command.paths, command.reading, level=level)
        return
    whole = [*(["level"] if level is not None else []), *(["moving"] if command.moving else [])]
    whole += needs_all_rows(command.select)
    with opened(command.paths, command.reading, command.max_memory, whole=whole) as scene:
        yield scene if level is None or isinstance(scene, Store) else level_of(scene, level)


def _drawn(
    command: Command, scene: Scene | Store, views: Views, targets: list[Targets], video: Path | None
) -> tuple[View, ...]:
    drawn = []
    with ExitStack() as stack:
        add = stack.enter_context(open_video(video, fps=command.fps, force=command.force)) if video else None
        for target, (result, frame) in zip(targets, _frames(command, scene, views), strict=True):
            target.write(result, force=command.force)
            if target.counters is not None and isinstance(frame, Frame):
                described = scene.scene if isinstance(scene, Store) else scene
                write_counters(frame_counters(described, frame), target.counters, force=command.force)
            if add is not None:
                add(result.image)
            drawn.append(_view(result, frame, target.picture))
    return tuple(drawn)


def _frames(
    command: Command, scene: Scene | Store, views: Views
) -> Iterator[tuple[RenderResult, Frame] | tuple[MovedFrame, MovedFrame]]:
    """Each picture, with the selection and the camera that it is of."""
    if command.moving:
        with open_session(scene, device=command.device, options=command.options, select=command.select) as session:
            motion = session.motion()
            for camera in track(list(views.cameras), "render views"):
                moved = motion.draw(camera)
                yield moved, moved
        return
    wanted = Wanted(last_pair=command.counters is not None)
    for frame in trace_batch(
        scene, views.cameras, command.options, command.select, wanted=wanted, device=command.device
    ):
        yield frame.result, frame


def show(rendered: Rendered, *, verbose: bool = False) -> str:
    """What was written, how views were chosen, and with ``verbose`` what each took."""
    rows: list[dict[str, object]] = [
        {"view": view.name, "nodes": view.selected, "pairs": view.pairs}
        | ({f"{stage} ms": ms for stage, ms in view.ms.items()} if verbose else {})
        for view in rendered.views
    ]
    lines = [table(rows)] if len(rows) > 1 or verbose else []
    said = (*rendered.notes, *(note for view in rendered.views for note in view.notes))
    lines += [f"note: {note}" for note in dict.fromkeys(said)]
    lines += [f"view: {reason}" for reason in rendered.reasons]
    if rendered.num_removed:
        lines.append(f"removed {rendered.num_removed} picture{'s' * (rendered.num_removed != 1)} of an earlier run")
    written = (rendered.output, rendered.video, rendered.counters)
    return "\n".join([*lines, f"wrote {' and '.join(str(target) for target in written if target)}"])


def _view(result: RenderResult | MovedFrame, frame: Frame | MovedFrame, file: Path | None) -> View:
    counters, chosen = result.counters, frame.selection
    return View(
        name=frame.camera.name,
        file=file,
        selected=counters.num_selected,
        pairs=counters.num_pairs,
        pixel_error=chosen.pixel_error,
        ms=result.milliseconds,
        notes=chosen.notes,
    )
