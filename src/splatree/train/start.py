"""Where training starts: a Gaussian for each point of the cameras' model, and some where no point is.

A point becomes a sphere of σ = the root mean square distance to its three nearest neighbours, held to [mean / 6, 4 mean]. Corners
that no point reaches would stay empty, because births come only from what is there. So each photograph is divided into cells of
its plane; a cell in which no Gaussian lies gets one, at the median depth of its surroundings and of the photograph's own colour.
Beyond the borders of all photographs, planes go on for a few cells: the apron. Without any points, `RANDOM_POINTS` lie in the box
of the cameras.

Cost: once a run; a fraction of a second for 100,000 points.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.io.cameras.points import Points
from splatree.maths.morton import MortonFrame, morton_codes, morton_frame
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Bool, Float64, Int64, UInt8

__all__ = [
    "EXTENT_MARGIN",
    "add_apron",
    "extent_of",
    "fill_empty_cells",
    "neighbour_distances",
    "random_points",
    "start_from",
]

EXTENT_MARGIN = 1.1
"""Largest distance of a camera from their mean, times this, is the extent (Kerbl 2023)."""

RANDOM_POINTS = 50_000
"""Points where the cameras come without."""

START_OPACITY = 0.2
"""Of a Gaussian that stands for a point."""

EMPTY_OPACITY = 0.1
"""Of a Gaussian in an empty cell."""

CELLS = 16
"""Cells along the longer side of a photograph."""

APRON_CELLS = 4
"""So many cells beyond the border of a photograph get one too, where no photograph shows anything."""

PLANE_CELLS = 16
"""Cells around an empty one, to which a plane is fitted that it goes on with."""

PLANE_ERROR = 0.05
"""Root mean square error of the plane, as a share of their depth, up to which they lie on it."""

FARTHEST = 1.5
"""A plane is continued up to so many times the depth, or the nearness, of what is known."""

BEFORE = 0.8
"""What lies nearer than this share of a depth would hide what is there."""

APRON_OPACITY = 0.8
"""Of a Gaussian beyond the borders: no photograph may ever change it."""

SEEN_BY_MIN = 3
"""Points found in fewer pictures are often wrong; the rule counts only where the file says how many."""

_NEIGHBOURS = 8
"""Neighbours along a curve, before and after, that are looked at."""

_CURVES = ((0.0, 0.0, 0.0), (0.31, 0.17, 0.43), (0.13, 0.41, 0.23))
"""Shifts of the grid, as shares of its side: cells that one curve parts lie together along another."""


def extent_of(cameras: Sequence[Camera]) -> float:
    """How far the cameras reach: the length that rates of the means are in.

    Raises:
        InputError: all cameras stand at one place, from where no depth can be learned.
    """
    positions = np.array([camera.position for camera in cameras])
    extent = EXTENT_MARGIN * float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    if not extent > 1e-9 * max(1.0, float(np.abs(positions).max())):
        raise InputError(
            f"cameras: found all {len(cameras)} training views at one place, wanted different ones; one place shows no depth"
        )
    return extent


def start_from(points: Points, *, degree: int, max_gaussians: int, rng: np.random.Generator) -> Gaussians:
    """A Gaussian for each point that enough pictures show; of more than ``max_gaussians`` a random part."""
    chosen = np.flatnonzero(points.num_pictures >= SEEN_BY_MIN) if points.num_pictures.any() else np.arange(len(points))
    if not len(chosen):
        chosen = np.arange(len(points))
    if len(chosen) > max_gaussians:
        chosen = np.sort(rng.choice(chosen, max_gaussians, replace=False))
    places = points.places[chosen]
    sigma = neighbour_distances(places)
    mean = max(float(sigma.mean()), 1e-12)
    sigma = np.clip(sigma, mean / 6, 4 * mean)
    return _spheres(places, sigma, points.colors[chosen], START_OPACITY, degree)


def random_points(cameras: Sequence[Camera], extent: float, rng: np.random.Generator) -> Points:
    """Grey points in the box of the cameras, which is `extent` larger on each side."""
    positions = np.array([camera.position for camera in cameras])
    low, high = positions.min(axis=0) - extent, positions.max(axis=0) + extent
    places = rng.uniform(low, high, (RANDOM_POINTS, 3))
    colors = rng.integers(96, 160, (RANDOM_POINTS, 3)).astype(np.uint8)
    return Points(places, colors, np.zeros(RANDOM_POINTS, np.int32))


def neighbour_distances(places: Float64[Array, "n 3"]) -> Float64[Array, "n"]:
    """Root mean square distance to three near neighbours.

    They are the nearest of those along three Morton curves: for most points the nearest of all, for others a little further.
    """
    n = len(places)
    if n < 2:
        return np.ones(n)
    frame, nearest = morton_frame(places), np.full((n, 0), np.inf)
    for shift in _CURVES:
        low = np.asarray(frame.low) - np.asarray(shift) * frame.side
        codes = morton_codes(places, MortonFrame((low[0], low[1], low[2]), 2 * frame.side))
        order = np.argsort(codes, kind="stable")
        row, found = places[order], np.full((n, 2 * _NEIGHBOURS), np.inf)
        for step in range(1, min(_NEIGHBOURS, n - 1) + 1):
            squared = np.sum((row[step:] - row[:-step]) ** 2, axis=1)
            found[:-step, step - 1], found[step:, _NEIGHBOURS + step - 1] = squared, squared
        back = np.empty_like(found)
        back[order] = found
        nearest = np.sort(np.concatenate([nearest, back], axis=1), axis=1)
        # The same neighbour may come along several curves: it counts once, by its distance.
        nearest[:, 1:][nearest[:, 1:] == nearest[:, :-1]] = np.inf
        nearest = np.sort(nearest, axis=1)[:, :3]
    known = np.where(np.isfinite(nearest), nearest, 0.0)
    return np.asarray(np.sqrt(known.sum(axis=1) / np.isfinite(nearest).sum(axis=1)))


def fill_empty_cells(
    gaussians: Gaussians, cameras: Sequence[Camera], photo_of: Callable[[int], UInt8[Array, "h w 3"]], *, room: int
) -> Gaussians:
    """The Gaussians, and one in each cell of each view in which none lies, at most ``room`` of them.

    Args:
        gaussians: what there is.
        cameras: the views; what one of them gets, the next ones see.
        photo_of: the photograph of a view, at any size.
        room: Gaussians that may be added.
    """
    places, added = gaussians.means.astype(np.float64), []
    for i, camera in enumerate(cameras):
        across, down = _cells(camera)
        depths = _median_depths(places, camera, across, down)
        empty = np.argwhere(np.isnan(depths))
        if not len(empty) or len(empty) == depths.size or room <= 0:
            continue
        filled = np.argwhere(~np.isnan(depths))
        to = np.argmin(np.sum((empty[:, None] - filled) ** 2, axis=2), axis=1)
        z = depths[tuple(filled[to].T)][:room]
        empty = empty[:room]
        pixel = (empty[:, ::-1] + 0.5) * (camera.width / across, camera.height / down)
        new = _placed(pixel, z, camera)
        photo = photo_of(i)
        row, column = (pixel[:, ::-1] * (photo.shape[0] / camera.height, photo.shape[1] / camera.width)).astype(int).T
        sigma = z * max(camera.width, camera.height) / (2 * CELLS * camera.K[0, 0])
        added.append(_spheres(new, sigma, photo[row, column], EMPTY_OPACITY, gaussians.sh_degree))
        places = np.concatenate([places, new])
        room -= len(new)
    return Gaussians.concatenate([gaussians, *added])


def add_apron(
    gaussians: Gaussians, cameras: Sequence[Camera], photo_of: Callable[[int], UInt8[Array, "h w 3"]], *, room: int
) -> Gaussians:
    """The Gaussians, and one in each empty cell beyond the borders that no view shows, at most ``room`` of them.

    It lies on the plane of the cells around, and is of the mean colour of the nearest cell of the photograph. There is none
    where the cells around lie on no plane, or where it would hide from another view what that view has there.

    Args:
        gaussians: what there is.
        cameras: the views; what one of them gets, the next ones know of.
        photo_of: the photograph of a view, at any size.
        room: Gaussians that may be added.
    """
    known = gaussians.means.astype(np.float64)
    wide = [_widened(camera) for camera in cameras]
    depths_of = [_median_depths(known, camera, *cells) for camera, cells in wide]
    new, added = np.zeros((0, 3)), []
    for i, camera in enumerate(cameras):
        view, (across, down) = wide[i]
        depths = depths_of[i]
        empty, filled = (
            np.argwhere(np.isnan(depths) & np.isnan(_median_depths(new, view, across, down))),
            np.argwhere(~np.isnan(depths)),
        )
        if not len(empty) or not len(filled):
            continue
        z = _continued_depths(empty, filled, depths[tuple(filled.T)])
        empty, z = empty[z > view.near], z[z > view.near]
        places = _placed((empty[:, ::-1] + 0.5) * (view.width / across, view.height / down), z, view)
        refused = np.logical_or.reduce([_shown(places, other) for other in cameras])
        for (other, _), known_depths in zip(wide, depths_of, strict=True):
            refused |= _hides(places, other, known_depths)
        places, empty, z = places[~refused][:room], empty[~refused][:room], z[~refused][:room]
        inner = np.array(_cells(camera))
        cell = np.clip(empty - APRON_CELLS, 0, inner[::-1] - 1)
        colors = _cell_means(photo_of(i), *inner)[tuple(cell.T)]
        sigma = z * max(camera.width, camera.height) / (2 * CELLS * camera.K[0, 0])
        added.append(_spheres(places, sigma, colors, APRON_OPACITY, gaussians.sh_degree))
        new = np.concatenate([new, places])
        room -= len(places)
    return Gaussians.concatenate([gaussians, *added])


def _cells(camera: Camera) -> tuple[int, int]:
    """How many cells a photograph has across and down."""
    size = max(camera.width, camera.height) / CELLS
    return max(1, round(camera.width / size)), max(1, round(camera.height / size))


def _widened(camera: Camera) -> tuple[Camera, tuple[int, int]]:
    """The view with `APRON_CELLS` cells more on each side, and its cells across and down."""
    across, down = _cells(camera)
    margin = APRON_CELLS * np.array([camera.width / across, camera.height / down])
    K = camera.K.copy()
    K[:2, 2] += margin
    width, height = np.rint((camera.width, camera.height) + 2 * margin).astype(int)
    return replace(camera, K=K, width=int(width), height=int(height)), (
        across + 2 * APRON_CELLS,
        down + 2 * APRON_CELLS,
    )


def _placed(pixel: Array, depth: Array, camera: Camera) -> Float64[Array, "n 3"]:
    """Where what a view shows at pixels lies, if it lies at these depths."""
    slopes = (pixel - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    seen = np.concatenate([slopes, np.ones((len(depth), 1))], axis=1) * depth[:, None]
    pose = camera.camera_from_world
    return np.asarray((seen - pose[:3, 3]) @ pose[:3, :3])


def _continued_depths(
    empty: Int64[Array, "n 2"], filled: Int64[Array, "m 2"], depths: Float64[Array, "m"]
) -> Float64[Array, "n"]:
    """Depths of empty cells on the plane through those around; 0 where these lie on none, or it leaves their depths behind.

    The inverse depth of a plane is linear in the pixels of a pinhole.
    """
    near = np.argsort(np.sum((empty[:, None] - filled) ** 2, axis=2), axis=1, kind="stable")[:, :PLANE_CELLS]
    offsets = (filled[near] - empty[:, None]).astype(np.float64)
    A = np.concatenate([np.ones((*near.shape, 1)), offsets], axis=2)  # [n k 3]
    inverse = 1 / depths[near]
    found = np.einsum("nik,nk->ni", np.linalg.pinv(A), inverse)
    left = np.sqrt(np.square(np.einsum("nki,ni->nk", A, found) - inverse).mean(axis=1))
    ratio = found[:, 0] / inverse.mean(axis=1)
    fits = (left < PLANE_ERROR * inverse.mean(axis=1)) & (ratio > 1 / FARTHEST) & (ratio < FARTHEST)
    return np.where(fits, 1 / np.where(fits, found[:, 0], 1), 0)


def _seen(places: Array, camera: Camera) -> tuple[Float64[Array, "n 2"], Float64[Array, "n"], Bool[Array, "n"]]:
    """Pixels and depths of places in a view, and which of them lie within its picture."""
    seen = places @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixel = seen[:, :2] / seen[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]
    inside = (pixel >= 0).all(axis=1) & (pixel < (camera.width, camera.height)).all(axis=1)
    return pixel, seen[:, 2], np.asarray(inside & (seen[:, 2] > camera.near))


def _shown(places: Array, camera: Camera) -> Bool[Array, "n"]:
    """Which places lie within the picture of a view."""
    return _seen(places, camera)[2]


def _hides(places: Array, camera: Camera, depths: Float64[Array, "y x"]) -> Bool[Array, "n"]:
    """Which places lie well before what a view has in the same cell."""
    pixel, z, inside = _seen(places, camera)
    down, across = depths.shape
    cell = (pixel[inside] * (across / camera.width, down / camera.height)).astype(int)
    hides = np.zeros(len(places), bool)
    hides[inside] = z[inside] < BEFORE * depths[cell[:, 1], cell[:, 0]]  # not where the cell is empty: NaN
    return hides


def _cell_means(photo: UInt8[Array, "h w 3"], across: int, down: int) -> Float64[Array, "y x 3"]:
    """The mean colour of each cell of a photograph."""
    rows, columns = (np.arange(n) * side // n for n, side in ((down, photo.shape[0]), (across, photo.shape[1])))
    sums = np.add.reduceat(np.add.reduceat(photo, rows, axis=0, dtype=np.float64), columns, axis=1)
    # Of a photograph with fewer pixels than cells a cell without one has the sum of the pixel that it lies in.
    high, wide = (np.maximum(np.diff([*at, n]), 1) for at, n in ((rows, photo.shape[0]), (columns, photo.shape[1])))
    counts = high[:, None] * wide
    return np.asarray(sums / counts[..., None])


def _median_depths(places: Array, camera: Camera, across: int, down: int) -> Float64[Array, "y x"]:
    """The median depth of what lies in each cell of a view; NaN where nothing lies."""
    seen = places @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    seen = seen[seen[:, 2] > camera.near]
    pixel = seen[:, :2] / seen[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]
    cell = np.floor(pixel * (across / camera.width, down / camera.height))
    inside = (cell >= 0).all(axis=1) & (cell < (across, down)).all(axis=1)
    number = (cell[inside, 1] * across + cell[inside, 0]).astype(np.int64)
    order = np.lexsort((seen[inside, 2], number))
    numbers, first, count = np.unique(number[order], return_index=True, return_counts=True)
    depths = np.full(across * down, np.nan)
    depths[numbers] = seen[inside, 2][order][first + count // 2]
    return depths.reshape(down, across)


def _spheres(places: Array, sigma: Array, colors: Array, opacity: float, degree: int) -> Gaussians:
    n = len(places)
    quats, sh = np.zeros((n, 4), np.float32), np.zeros((n, (degree + 1) ** 2, 3), np.float32)
    quats[:, 0] = 1
    sh[:, 0] = (colors / 255.0 - 0.5) / SH_C0
    log_scales = np.repeat(np.log(np.maximum(sigma, 1e-12))[:, None], 3, axis=1)
    logit = np.log(opacity / (1 - opacity))
    return Gaussians(
        np.ascontiguousarray(places, np.float32),
        quats,
        log_scales.astype(np.float32),
        np.full(n, logit, np.float32),
        sh,
    )
