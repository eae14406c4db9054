"""What does not belong into a scene: specks and sheets, what lies far away, and floaters, pieces that touch nothing.

Each filter looks at all leaves of the scene as it was given, and says what it would drop; a leaf that any of them drops goes.

Floaters: space is divided into cubes of ``cell`` times the radius of the scene. Cubes with a leaf of opacity 0.1 or more are
occupied; occupied cubes that touch, also at a corner, make a piece. A piece with less than ``smallest_piece`` of the occupied
leaves is a floater, and so is a fainter leaf in no piece that stays.

Cost: a sort of the leaves' cubes, and one of the cubes for each of 13 neighbours.
"""

import math
from dataclasses import dataclass

import numpy as np

from splatree.edit.rows import keep_leaves
from splatree.errors import InputError
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Float64, Int64

__all__ = ["CleanOptions", "Cleaned", "clean", "would_drop"]

OCCUPIED = 0.1
"""Opacity from which a leaf holds pieces together: fog joins everything."""

REACH = 1 << 20
"""Cubes along each axis, each way from the middle: three times 21 bits make a key; what lies farther shares the last ones."""


@dataclass(frozen=True)
class CleanOptions:
    """Which leaves are dropped.

    Example:
        >>> st.clean(scene, st.CleanOptions(max_size=1000.0)).num_dropped
        0
    """

    max_size: float | None = None
    """Drop Gaussians whose longest standard deviation is larger than this, world units."""
    min_size: float | None = None
    """Drop Gaussians whose longest standard deviation is smaller than this, world units."""
    max_distance: float | None = None
    """Drop Gaussians that lie farther than this many radii from the middle; with cameras, from the nearest camera, in radii of
    the cameras. A radius holds half of the Gaussians, or of the cameras, around their median."""
    floaters: bool = False
    """Drop pieces that touch nothing: connected cubes with few Gaussians in them."""
    cell: float = 0.05
    """For floaters: edge of a cube, in radii of the scene."""
    smallest_piece: float = 0.01
    """For floaters: share of the Gaussians that a piece must have to stay."""

    def __post_init__(self) -> None:
        for name in ("max_size", "min_size", "max_distance", "cell"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"{name}: found {value}, wanted more than 0")
        if not 0 < self.smallest_piece < 1:
            raise InputError(f"smallest_piece: found {self.smallest_piece}, wanted between 0 and 1")


@dataclass(frozen=True, eq=False)
class Cleaned:
    """A scene without the leaves that were dropped.

    Example:
        >>> cleaned = st.clean(scene, st.CleanOptions(max_distance=2.0))
        >>> cleaned.scene.tree.num_leaves + cleaned.num_dropped == scene.tree.num_leaves
        True
    """

    scene: Scene
    """The leaves that are left, with those merged nodes whose leaves all stay."""
    dropped: dict[str, int]
    """Number of leaves that each filter drops. A leaf that several filters drop counts for each."""
    num_dropped: int
    """Number of leaves dropped in all."""


def clean(scene: Scene, options: CleanOptions, *, cameras: Float64[Array, "v 3"] | None = None) -> Cleaned:
    """Drop leaves that do not belong to a scene: floaters, and Gaussians that are too large, too small or too far.

    Args:
        scene: any scene, flat or with levels.
        options: the filters.
        cameras: centres of the cameras, world units, for ``max_distance``.

    Returns:
        The scene that is left, with counts.

    Raises:
        InputError: nothing would be left.

    Example:
        >>> cleaned = st.clean(scene, st.CleanOptions(floaters=True, max_size=50.0))
        >>> sorted(cleaned.dropped)
        ['floaters', 'larger than max_size']
    """
    leaves = np.flatnonzero(scene.tree.is_leaf)
    dropped = {name: leaves[mask] for name, mask in _filters(scene, leaves, options, cameras)}
    kept = np.ones(len(scene), bool)
    for rows in dropped.values():
        kept[rows] = False
    num_dropped = len(scene) - int(kept.sum())
    if num_dropped == len(leaves) and len(leaves):
        counts = ", ".join(f"{name} {len(rows):,}" for name, rows in dropped.items())
        raise InputError(
            f"clean: found filters that drop all {len(leaves):,} Gaussians ({counts}), wanted some to be left"
        )
    return Cleaned(keep_leaves(scene, kept), {name: len(rows) for name, rows in dropped.items()}, num_dropped)


def would_drop(scene: Scene, options: CleanOptions) -> dict[str, int]:
    """How many leaves each filter of `clean` would drop, without cameras; no scene is made, and all of them may go."""
    leaves = np.flatnonzero(scene.tree.is_leaf)
    return {name: int(mask.sum()) for name, mask in _filters(scene, leaves, options, None)}


def _filters(
    scene: Scene, leaves: Int64[Array, "n"], options: CleanOptions, cameras: Array | None
) -> list[tuple[str, Bool[Array, "n"]]]:
    g = scene.gaussians
    means = g.means[leaves].astype(np.float64)
    sizes = np.exp(g.log_scales[leaves].max(axis=1, initial=-np.inf).astype(np.float64))
    found = []
    if options.max_size is not None:
        found.append(("larger than max_size", sizes > options.max_size))
    if options.min_size is not None:
        found.append(("smaller than min_size", sizes < options.min_size))
    if len(leaves) and options.max_distance is not None:
        points = means if cameras is None else np.asarray(cameras, np.float64)
        centre, radius = _middle(points)
        distances = np.linalg.norm(means - centre, axis=1) if cameras is None else _nearest(means, points)
        found.append(("farther than max_distance", distances > options.max_distance * radius))
    if len(leaves) and options.floaters:
        opaque = g.logit_opacities[leaves] >= math.log(OCCUPIED / (1 - OCCUPIED))
        found.append(("floaters", _floaters(means, opaque, options)))
    return found


def _middle(points: Array) -> tuple[Array, float]:
    """The median along each axis, and the distance from there that holds half of the points."""
    centre = np.median(points, axis=0)
    return centre, max(float(np.median(np.linalg.norm(points - centre, axis=1))), 1e-12)


def _nearest(points: Array, cameras: Array) -> Array:
    """Distance of each point to the nearest camera."""
    nearest = np.full(len(points), np.inf)
    for camera in cameras:
        np.minimum(nearest, np.linalg.norm(points - camera, axis=1), out=nearest)
    return nearest


def _floaters(means: Array, opaque: Array, options: CleanOptions) -> Bool[Array, "n"]:
    centre, radius = _middle(means)
    cells = np.floor((means - centre) / (options.cell * radius))
    cells = np.clip(cells, -REACH + 2, REACH - 2).astype(np.int64) + REACH
    keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    occupied, counts = np.unique(keys[opaque], return_counts=True)
    if len(occupied) == 0:
        return np.zeros(len(means), bool)
    pieces = _pieces(occupied)
    rows_per_piece = np.bincount(pieces, weights=counts, minlength=len(occupied))
    stays = rows_per_piece >= options.smallest_piece * counts.sum()
    stays[np.argmax(rows_per_piece)] = True
    place = np.minimum(np.searchsorted(occupied, keys), len(occupied) - 1)
    return np.asarray(~((occupied[place] == keys) & stays[pieces[place]]))


def _pieces(occupied: Int64[Array, "m"]) -> Int64[Array, "m"]:
    """The piece of each occupied cube, numbered by its first cube: labels sink along touching cubes until none changes."""
    steps = [(x << 42) + (y << 21) + z for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    pairs = []
    for step in steps[14:]:  # the other half are the same pairs
        place = np.minimum(np.searchsorted(occupied, occupied + step), len(occupied) - 1)
        touching = np.flatnonzero(occupied[place] == occupied + step)
        pairs.append(np.stack([touching, place[touching]]))
    a, b = np.concatenate(pairs, axis=1)
    labels = np.arange(len(occupied))
    while True:
        before = labels.copy()
        least = np.minimum(labels[a], labels[b])
        np.minimum.at(labels, labels[a], least)
        np.minimum.at(labels, labels[b], least)
        while not np.array_equal(labels, labels[labels]):
            labels = labels[labels]
        if np.array_equal(labels, before):
            return labels
