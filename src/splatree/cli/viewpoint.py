"""From where to draw: given cameras, a point and a target, or a view that is chosen for the scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from splatree.cli.console import UsageError
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.render.framing.frame import frame_scene
from splatree.render.overlap import overlap_hint
from splatree.render.paths import PathOptions, flyout, orbit, turn
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.scene import Scene

__all__ = ["Viewpoint", "Views", "named_views", "relative_to", "views_of"]

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Viewpoint:
    """From where to draw."""

    cameras: Path | None = None
    """Draw these views: cameras.json, transforms.json or a COLMAP model. Without it a view is chosen for the scene."""
    view: str | None = None
    """Draw one view only: its number, from 0, or the name of a camera."""
    eye: Point | None = None
    """Draw from this point x y z, world units."""
    target: Point | None = None
    """Look at this point x y z, world units."""
    distance: float | None = None
    """Draw from so far away from the target, world units."""
    look: Literal["auto", "outside", "inside"] = "auto"
    """Look at the scene from outside, or around from inside; `auto` decides by the scene."""
    path: Literal["turn", "orbit", "flyout"] = "turn"
    """Views to make without --cameras: `turn` all round, from the view that is chosen; `orbit` on a circle about the middle;
    `flyout` away from it."""
    scale: float = 1.0
    """Factor on the width and height of the cameras."""

    def __post_init__(self) -> None:
        if not self.scale > 0:
            raise InputError(f"scale: found {self.scale}, wanted more than 0")
        moved = [name for name in ("eye", "target", "distance") if getattr(self, name) is not None]
        moved += ["look"] if self.look != "auto" else []
        if moved and (self.cameras is not None or self.path != "turn"):
            other = "--cameras" if self.cameras is not None else f"--path {self.path}"
            raise InputError(
                f"{', '.join(moved)}: found beside {other}, which says from where to draw; wanted one of them"
            )


@dataclass(frozen=True)
class Views:
    """The views to draw."""

    cameras: tuple[Camera, ...]
    """In order."""
    reasons: tuple[str, ...] = ()
    """How they were chosen, a sentence each; none for given cameras."""
    notes: tuple[str, ...] = ()
    """What the reader of the cameras chose or left out."""


def relative_to(views: Views, scene: Scene) -> Views:
    """Views of files in the coordinates of a scene, and a note if none of them sees it."""
    cameras = Cameras(views.cameras).relative_to(scene.source).views
    hint = overlap_hint(scene, cameras)
    return replace(views, cameras=cameras, notes=(*views.notes, *([hint] if hint else [])))


def named_views(viewpoint: Viewpoint) -> Views | None:
    """The views of --cameras, read before the scene is; None without."""
    if viewpoint.cameras is None:
        return None
    named = read_cameras(viewpoint.cameras)
    cameras = [camera.scaled(viewpoint.scale) for camera in named]
    return Views(_chosen(cameras, viewpoint.view), notes=named.notes)


def views_of(scene: Scene, viewpoint: Viewpoint, made: PathOptions) -> Views:
    """The views that are made for a scene."""
    reasons: tuple[str, ...] = ()
    if viewpoint.path == "turn":
        inside = None if viewpoint.look == "auto" else viewpoint.look == "inside"
        framing = frame_scene(scene, up=made.up, inside=inside, aspect=made.width / made.height)
        eye, target = (_relative(point, scene) for point in (viewpoint.eye, viewpoint.target))
        framing = framing.moved(eye=eye, target=target, distance=viewpoint.distance)
        if viewpoint.eye is not None:  # then the point given stays what it is
            made = replace(made, elevation_deg=None)
        cameras, reasons = turn(framing, made), framing.reasons
    else:
        cameras = (orbit if viewpoint.path == "orbit" else flyout)(scene, made)
    return Views(_chosen([camera.scaled(viewpoint.scale) for camera in cameras], viewpoint.view), reasons)


def _relative(point: Point | None, scene: Scene) -> Point | None:
    """A point of the world in the coordinates of a scene."""
    if point is None:
        return None
    x, y, z = (a - b for a, b in zip(point, scene.source.origin, strict=True))
    return x, y, z


def _chosen(cameras: Sequence[Camera], view: str | None) -> tuple[Camera, ...]:
    """All of them, or the one that --view names."""
    if view is None:
        return tuple(cameras)
    named = [camera for camera in cameras if view in (camera.name, Path(camera.name).stem)]
    if len(named) == 1:
        return (named[0],)
    if len(named) > 1:
        raise UsageError(f"view: found {len(named)} views named {view!r}, wanted a number from 0 to {len(cameras) - 1}")
    if view.isascii() and view.isdigit() and int(view) < len(cameras):
        return (cameras[int(view)],)
    example = cameras[0].name
    raise UsageError(
        f"view: found {view!r}, wanted a number from 0 to {len(cameras) - 1} or a name such as {example!r}"
    )
