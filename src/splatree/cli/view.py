"""``splatree view``: look at a scene in a browser."""

import contextlib
import sys
import webbrowser
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import Console, UsageError, counted
from splatree.cli.files import Reading, check_inputs, in_mode
from splatree.cli.opening import opened
from splatree.io.cameras.files import read_cameras
from splatree.io.photos import Photos
from splatree.outofcore.store import Store
from splatree.scene.cameras import Cameras
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.view.exhibit import has_levels
from splatree.view.options import ViewOptions
from splatree.view.viewer import Viewer


@dataclass(frozen=True)
class Command:
    """Look at a scene in a browser, also over SSH and without a GPU; Ctrl-C ends it."""

    paths: Positional[tuple[Path, ...]]
    """Scene; several files or folders are read as one. Levels of detail are built first where there are none."""
    beside: Path | None = None
    """Another scene to compare it with, side by side under one camera."""
    cameras: Path | None = None
    """Views to list: cameras.json, transforms.json or a COLMAP model."""
    photos: Path | None = None
    """Folder of the photographs of these views."""
    max_memory: str | None = None
    """Most memory for what is read of a .splatree or a folder of parts, such as 1G: only what the views need is read. A folder,
    and a .splatree larger than half of the free memory, is always shown so; by default it takes half of the free memory."""
    no_browser: bool = False
    """Only print the address."""
    mode: Mode | None = None
    """How a scene without levels of detail was trained and is drawn; None: as the file says, else `classic`."""
    options: Annotated[ViewOptions, arg(name="", help="")] = ViewOptions()
    reading: Annotated[Reading, arg(name="", help="")] = Reading()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Viewed:
    """What was shown."""

    url: str
    """Address that it was shown at."""
    num_nodes: int
    """Nodes of the scene, with those that were built."""


def run(command: Command) -> Viewed:
    """Read, build what is missing, serve until interrupted."""
    check_inputs(command.paths)
    if command.photos is not None and command.cameras is None:
        raise UsageError("found --photos without --cameras, wanted the cameras that took them too")
    cameras = None if command.cameras is None else read_cameras(command.cameras)
    photos = None
    if command.photos is not None and cameras is not None:
        photos = Photos(command.photos, list(cameras))
    with ExitStack() as stack:
        scene, beside = (
            None if paths is None else stack.enter_context(opened(paths, command.reading, command.max_memory))
            for paths in (command.paths, None if command.beside is None else (command.beside,))
        )
        assert scene is not None
        return _shown(command, scene, beside, cameras, photos)


def _shown(
    command: Command,
    scene: Scene | Store,
    beside: Scene | Store | None,
    cameras: Cameras | None,
    photos: Photos | None,
) -> Viewed:
    """Show scenes until interrupted."""
    if isinstance(scene, Scene):
        scene = in_mode(scene, command.mode)
    elif command.mode not in (None, scene.scene.mode):
        raise UsageError(
            f"mode: found {command.mode} for {command.paths[0]}, which is shown as its file says, in {scene.scene.mode}; leave "
            "the mode out, or build the levels anew from their leaves: splatree build in.splatree out.splatree --mode "
            f"{command.mode}"
        )
    source = (scene if isinstance(scene, Scene) else scene.scene).source
    cameras = None if cameras is None else cameras.relative_to(source)
    for path, shown in ((command.paths[0], scene), (command.beside, beside)):
        if shown is not None and not has_levels(shown):
            _say(command, f"{path}: has no levels of detail; building them (splatree build keeps them in a file)")
    names = (command.paths[0].name or str(command.paths[0]), "" if command.beside is None else command.beside.name)
    viewer = Viewer(scene, command.options, beside=beside, names=names, cameras=cameras, photos=photos)
    with viewer, contextlib.suppress(KeyboardInterrupt):  # from here on Ctrl-C is the usual end
        _announce(viewer, command)
        if not command.no_browser:
            webbrowser.open(viewer.url)
        viewer.wait()
    return Viewed(viewer.url, viewer.num_nodes)


def _announce(viewer: Viewer, command: Command) -> None:
    """Say where to look, at once: the result comes only at the end."""
    _say(command, f"look at {viewer.url}")
    if command.options.is_local:
        forward = f"ssh -L {viewer.port}:localhost:{viewer.port} this-machine"
        _say(command, f"from another machine: {forward}, then open the same address there")
    _say(command, "Ctrl-C ends it")


def _say(command: Command, line: str) -> None:
    if not command.console.quiet:
        print(line, file=sys.stderr, flush=True)


def show(viewed: Viewed) -> str:
    """The result in words."""
    return f"showed {counted(viewed.num_nodes, 'node')} at {viewed.url}"
