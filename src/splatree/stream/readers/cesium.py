"""The tiles that CesiumJS 1.145 chooses of a tileset: those whose error looks small enough, from the root down.

A tile is refined while its geometric error, at the distance of its box from the eye, looks larger than 16 pixels:
error · height / (distance · 2 tan(fov_y / 2)) > 16. Tiles whose box lies outside the view are neither drawn nor refined. A tile
is drawn until all of its children are there. So the tiles above those that are drawn are loaded too, and so are all children of a
tile that is refined, those outside the view as well.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatree.scene.cameras import Camera
from splatree.shapes import Array, Float64, Int64, check_fields

__all__ = ["TilesChosen", "Tileset", "open_tileset", "select_cesium"]


@dataclass(frozen=True, eq=False)
class Tileset:
    """A tileset that `splatree.stream.tiles` wrote, parents first."""

    names: tuple[str, ...]
    """File of each tile, relative to the folder."""
    boxes: Float64[Array, "t 2 3"]
    """Lower and upper corner in the axes of the scene."""
    errors: Float64[Array, "t"]
    """Geometric errors, world units."""
    parents: Int64[Array, "t"]
    """The tile above, −1 above the root."""
    bytes: Int64[Array, "t"]
    """Size of each file."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class TilesChosen:
    """Tiles of a view."""

    drawn: Int64[Array, "d"]
    """Tiles that are drawn."""
    loaded: Int64[Array, "l"]
    """These, the tiles above them, and all children of those above."""

    def __post_init__(self) -> None:
        check_fields(self)


def open_tileset(folder: Path) -> Tileset:
    """Read the ``tileset.json`` of a folder."""
    root = json.loads((folder / "tileset.json").read_text("utf-8"))["root"]
    names: list[str] = []
    boxes: list[list[Array]] = []
    errors: list[float] = []
    parents: list[int] = []
    pending: list[tuple[dict[str, Any], int]] = [(root, -1)]
    while pending:
        node, parent = pending.pop()
        box = np.array(node["boundingVolume"]["box"], np.float64)
        centre = np.array([-box[0], -box[2], -box[1]])  # of (−x, −z, −y)
        half = np.array([box[3], box[11], box[7]])
        pending += [(child, len(names)) for child in reversed(node.get("children", []))]
        names.append(str(node["content"]["uri"]))
        boxes.append([centre - half, centre + half])
        errors.append(float(node["geometricError"]))
        parents.append(parent)
    sizes = [(folder / name).stat().st_size for name in names]
    return Tileset(tuple(names), np.array(boxes), np.array(errors), np.array(parents), np.array(sizes, np.int64))


def select_cesium(tiles: Tileset, camera: Camera, *, most_px: float = 16.0) -> TilesChosen:
    """The tiles of a view, with ``maximumScreenSpaceError`` = ``most_px``."""
    away = np.clip(camera.position, tiles.boxes[:, 0], tiles.boxes[:, 1]) - camera.position
    distances = np.linalg.norm(away, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        looks_px = np.where(tiles.errors > 0, tiles.errors * camera.K[1, 1] / distances, 0)
    is_visible = _in_view(tiles.boxes, camera)
    is_leaf = np.ones(len(tiles.names), bool)
    is_leaf[tiles.parents[tiles.parents >= 0]] = False
    is_refined = is_visible & (looks_px > most_px) & ~is_leaf
    is_loaded, is_drawn = np.zeros(len(tiles.names), bool), np.zeros(len(tiles.names), bool)
    is_opened = np.zeros(len(tiles.names), bool)  # drawn by its children
    for tile, parent in enumerate(tiles.parents):
        is_loaded[tile] = is_opened[parent] if parent >= 0 else is_visible[tile]
        is_opened[tile] = is_loaded[tile] and is_refined[tile]
        is_drawn[tile] = is_loaded[tile] and is_visible[tile] and not is_refined[tile]
    return TilesChosen(np.flatnonzero(is_drawn), np.flatnonzero(is_loaded))


def _in_view(boxes: Array, camera: Camera) -> Array:
    """Whether a box is not wholly beyond one side of the view."""
    pick = np.array([[i >> axis & 1 for axis in range(3)] for i in range(8)])
    corners = np.stack([boxes[:, pick[:, axis], axis] for axis in range(3)], axis=2)  # [t 8 3]
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    x, y, z = np.moveaxis(corners @ rotation.T + translation, 2, 0)
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    sides = (
        z,
        fx * x + cx * z,
        (camera.width - cx) * z - fx * x,
        fy * y + cy * z,
        (camera.height - cy) * z - fy * y,
    )
    return np.asarray(np.logical_and.reduce([(side > 0).any(axis=1) for side in sides]))
