"""A scene on show: what the worker of each page asks of it, and what the page is told at first.

A session selects and draws; calls of several pages take turns. Coordinates of the page are relative to a centre: a
scene in map coordinates keeps its precision in the float32 of a browser.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.outofcore.store import Store
from splatree.progress import task
from splatree.render.build import build_lod
from splatree.render.framing.frame import Framing, frame_scene
from splatree.render.framing.trial import FOCUS_RADII
from splatree.render.session import Session, open_session
from splatree.scene.cameras import Camera
from splatree.scene.frame import RenderResult, Selection
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import View
from splatree.shapes import Array, Float64
from splatree.simplify.merge import check_finite
from splatree.view.shown import InMemory, Shown, shown_of

__all__ = ["Exhibit", "exhibit", "has_levels", "with_levels"]

FLAT_MAX = 10_000
"""Scenes of more Gaussians get levels before they are shown: fewer fit into any budget as they are."""

SAMPLE = 60_000
"""Leaves of which the width of a scene is taken."""

WIDE_SHARE = 0.99
"""Share of the leaves that a window has to be wide enough for."""


@dataclass(frozen=True, eq=False)
class Exhibit:
    """A scene as it is shown."""

    shown: Shown
    """What is shown."""
    session: Session
    """What selects and draws, one call at a time."""
    name: str
    """What it is called in the page."""
    framing: Framing
    """What is up, how large it is, and the view that is shown first."""

    @property
    def scene(self) -> Scene:
        """What is shown, with its block index."""
        return self.session.scene

    @property
    def centre(self) -> Float64[Array, "3"]:
        """Where the coordinates of the page begin, world units."""
        return self.framing.centre

    def cut(self, camera: Camera, options: SelectOptions, last: float | None) -> Selection:
        """The rows of a view; the search of a budget begins at ``last``."""
        return self.session.select(camera, select=options, last=last)

    def draw(
        self,
        camera: Camera,
        what: SelectOptions | Selection,
        background: tuple[float, float, float],
        *,
        box: Array | None = None,
        last: float | None = None,
    ) -> tuple[RenderResult, Selection]:
        """The picture of a view and what it drew: what options choose, or rows that were chosen before.

        Of a ``box`` "2 3" only what has its centre inside is drawn, world units; the search of a budget begins at ``last``, px.
        """
        found: list[Selection] = []
        drawn = RenderOptions(background=background)

        def within(view: View, *, threads: int = 0) -> Selection:
            chosen = what
            if isinstance(chosen, SelectOptions):
                chosen = self.session.select(camera, options=drawn, select=chosen, last=last)
            if box is not None:
                means = self.shown.means(chosen.rows)
                chosen = replace(chosen, rows=chosen.rows[((means >= box[0]) & (means <= box[1])).all(axis=1)])
            found.append(chosen)
            return chosen

        result = self.session.draw(camera, options=drawn, select=within)
        return result, found[-1]

    @property
    def facts(self) -> dict[str, Any]:
        """What the page is told of it."""
        scene, framing = self.scene, self.framing
        return {
            "name": self.name,
            "nodes": self.shown.num_nodes,
            "leaves": self.shown.num_leaves,
            "levels": self.shown.num_levels,
            "degree": scene.gaussians.sh_degree,
            "mode": scene.mode,
            "centre": (framing.centre + scene.source.origin).tolist(),
            "radius": framing.radius,
            "up": framing.up.tolist(),
            "sure": framing.is_sure,
            "inside": framing.inside,
            "near": framing.camera().near,
            "fov": framing.fov_y_deg,
            "eye": (framing.eye - framing.centre).tolist(),
            "target": (framing.target - framing.centre).tolist(),
            "aspect": self._aspect(),
            "occlusion": isinstance(self.shown, InMemory),
            "clusters": 0 if scene.clusters is None else len(scene.clusters),
        }

    def _aspect(self) -> float:
        """Width over height of a window that is just wide enough for the dense part of the scene in the first view."""
        framing, camera = self.framing, self.framing.camera()
        sample = self.shown.sample
        means = sample.gaussians.means[sample.tree.is_leaf]
        means = means[:: -(-len(means) // SAMPLE)].astype(np.float64)
        means = means[np.linalg.norm(means - framing.centre, axis=1) < FOCUS_RADII * framing.radius]
        x, _, z = (means @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]).T
        is_ahead = z > camera.near
        if not is_ahead.any():
            return 1.0
        half_height = np.tan(np.radians(framing.fov_y_deg) / 2)
        return float(np.quantile(np.abs(x[is_ahead]) / z[is_ahead], WIDE_SHARE) / half_height)


def exhibit(
    scene: Scene | Store,
    name: str = "scene",
    *,
    framing: Framing | None = None,
    up: Sequence[float] | None = None,
    device: DeviceName = "cpu",
) -> Exhibit:
    """Make a scene ready to be shown: with levels and a block index, and a first view.

    Args:
        scene: what is shown; a store is read page by page.
        name: what it is called in the page.
        framing: how to look at it first; None: decided by the scene.
        up: direction that is up, for a framing that is decided here; None: guessed.
        device: where views are selected and pictures drawn.

    Raises:
        InputError: the scene is empty, or was not read from a file and holds what is not finite.
    """
    if len(scene) == 0:
        raise InputError(f"{name}: found no Gaussians, wanted at least one to show")
    if isinstance(scene, Scene) and not scene.source.paths:  # files are checked when they are read
        check_finite(scene.gaussians)
    session = open_session(scene if isinstance(scene, Store) else with_levels(scene), device=device)
    shown = shown_of(scene if isinstance(scene, Store) else session.scene)
    if framing is None:
        with task(f"frame {name}"):
            framing = frame_scene(shown.sample, up=up)
    return Exhibit(shown, session, name, framing)


def has_levels(scene: Scene | Store) -> bool:
    """Whether a scene can be shown as it is: it has levels of detail, or is small enough to do without, or is a store."""
    if isinstance(scene, Store):
        return True
    return bool(scene.tree.depth.any()) or len(scene) <= FLAT_MAX


def with_levels(scene: Scene) -> Scene:
    """The scene with levels of detail: built now if it needs them."""
    return scene if has_levels(scene) else build_lod(scene)
