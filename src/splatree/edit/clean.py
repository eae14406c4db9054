"""What does not belong into a scene: specks and sheets, what lies far away, and floaters, pieces that touch nothing.

Each filter looks at all leaves of the scene as it was given, and says what it would drop; a leaf that any of them drops goes.

Floaters: space is divided into cubes of ``cell`` times the radius of the scene. Cubes with a leaf of opacity 0.1 or more are
occupied; occupied cubes that touch, also at a corner, make a piece. A piece with less than ``smallest_piece`` of the occupied
leaves is a floater, and so is a fainter leaf in no piece that stays.

What a filter looks at of the whole scene, its middle and its pieces, is found by passes over three columns (`survey`). Then each
leaf is decided alone, so leaves may come in chunks (`splatree.io.cleaning`).

Cost: about ten passes over the means, a sort of the leaves' cubes in each chunk, and one of the cubes for each of 13 neighbours.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from splatree.edit.rows import keep_leaves
from splatree.errors import InputError
from splatree.maths.medians import median_of
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Float32, Float64, Int64, check_fields

__all__ = ["ROWS_AT_ONCE", "CleanOptions", "Cleaned", "Leaves", "Survey", "check_left", "clean", "survey", "would_drop"]

LEAST_RADIUS = 1e-12
"""World units: of a scene at one point."""

OCCUPIED = 0.1
"""Opacity from which a leaf holds pieces together: fog joins everything."""

REACH = 1 << 20
"""Cubes along each axis, each way from the middle: three times 21 bits make a key; what lies farther shares the last ones."""

ROWS_AT_ONCE = 1 << 17
"""Leaves that are looked at together."""


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
        check_literals(self)
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


@checked
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
    options = given(options, CleanOptions, "clean: options")
    rows = np.flatnonzero(scene.tree.is_leaf)
    counts, is_dropped = _decided(scene, rows, options, cameras)
    num_dropped = int(is_dropped.sum())
    check_left(counts, num_dropped, len(rows))
    kept = np.ones(len(scene), bool)
    kept[rows[is_dropped]] = False
    return Cleaned(keep_leaves(scene, kept), counts, num_dropped)


def would_drop(scene: Scene, options: CleanOptions) -> dict[str, int]:
    """How many leaves each filter of `clean` would drop, without cameras; no scene is made, and all of them may go."""
    return _decided(scene, np.flatnonzero(scene.tree.is_leaf), options, None)[0]


def check_left(counts: Mapping[str, int], num_dropped: int, num_leaves: int) -> None:
    """Refuse filters that leave nothing, given how many leaves each drops, and all together.

    Raises:
        InputError: they do.
    """
    if num_dropped == num_leaves and num_leaves:
        said = ", ".join(f"{name} {count:,}" for name, count in counts.items())
        raise InputError(
            f"clean: found filters that drop all {num_leaves:,} Gaussians ({said}), wanted some to be left"
        )


@dataclass(frozen=True, eq=False)
class Leaves:
    """What filters look at of some leaves."""

    means: Float32[Array, "n 3"]
    """As of `Gaussians`."""
    sizes: Float32[Array, "n"]
    """Logarithm of the longest standard deviation."""
    logit_opacities: Float32[Array, "n"]
    """As of `Gaussians`."""

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.means)

    @staticmethod
    def of(g: Gaussians) -> "Leaves":
        """Those of Gaussians, all of which are leaves."""
        return Leaves(g.means, g.log_scales.max(axis=1, initial=-np.inf), g.logit_opacities)


@dataclass(frozen=True, eq=False)
class Survey:
    """What filters have to know of all leaves of a scene; then each leaf is decided alone."""

    options: CleanOptions
    """The filters."""
    cameras: Float64[Array, "v 3"] | None
    """Centres of the cameras that distances are those to, world units; None: distances are those to the middle."""
    centre: Float64[Array, "3"]
    """The middle of the leaves, world units."""
    radius: float
    """The radius that distances are measured in, world units."""
    edge: float
    """Edge of a cube, world units."""
    cubes: Int64[Array, "m"]
    """Keys of the occupied cubes whose piece stays, ascending; none if no leaf is opaque enough to occupy one."""

    def __post_init__(self) -> None:
        check_fields(self)

    def decide(self, leaves: Leaves) -> tuple[dict[str, int], Bool[Array, "n"]]:
        """How many of the leaves each filter drops, and which of them any filter drops."""
        options, means = self.options, leaves.means.astype(np.float64)
        sizes = np.exp(leaves.sizes.astype(np.float64))
        found = {}
        if options.max_size is not None:
            found["larger than max_size"] = sizes > options.max_size
        if options.min_size is not None:
            found["smaller than min_size"] = sizes < options.min_size
        if options.max_distance is not None:
            distances = _nearest(means, [self.centre] if self.cameras is None else self.cameras)
            found["farther than max_distance"] = distances > options.max_distance * self.radius
        if options.floaters:
            keys = _cubes_of(means, self.centre, self.edge)
            place = np.searchsorted(self.cubes, keys)
            floats = np.append(self.cubes, -1)[place] != keys
            found["floaters"] = floats if len(self.cubes) else np.zeros(len(keys), bool)
        dropped = np.logical_or.reduce([np.zeros(len(leaves), bool), *found.values()])
        return {name: int(mask.sum()) for name, mask in found.items()}, dropped


def survey(
    begin: Callable[[], Iterable[Leaves]], num_leaves: int, options: CleanOptions, cameras: Array | None = None
) -> Survey:
    """Find what filters have to know of all leaves.

    Args:
        begin: begins a pass over the leaves, which come in chunks.
        num_leaves: how many there are.
        options: the filters.
        cameras: centres of the cameras, world units, for ``max_distance``.
    """
    points = None if cameras is None else np.asarray(cameras, np.float64)
    if points is not None and not (
        points.ndim == 2 and points.shape[1] == 3 and len(points) and np.isfinite(points).all()
    ):
        raise InputError(
            f"cameras: found an array of shape {points.shape}, wanted a centre x y z, finite, for each camera"
        )
    centre, radius = np.zeros(3), LEAST_RADIUS
    if num_leaves and (options.floaters or (options.max_distance is not None and points is None)):
        centre, radius = _middle(lambda: (leaves.means.astype(np.float64) for leaves in begin()), num_leaves)
    edge, cubes = options.cell * radius, np.zeros(0, np.int64)
    if num_leaves and options.floaters:
        cubes = _without_floaters(*_occupied(begin, centre, edge), options.smallest_piece)
    if points is not None:
        radius = _middle(lambda: [points], len(points))[1]
    return Survey(options, points, centre, radius, edge, cubes)


def _decided(
    scene: Scene, rows: Int64[Array, "n"], options: CleanOptions, cameras: Array | None
) -> tuple[dict[str, int], Bool[Array, "n"]]:
    """How many of the rows, which are leaves, each filter drops, and which of them go."""
    g = scene.gaussians

    def begin() -> Iterator[Leaves]:
        for first in range(0, len(rows), ROWS_AT_ONCE):
            of = rows[first : first + ROWS_AT_ONCE]
            yield Leaves(g.means[of], g.log_scales[of].max(axis=1), g.logit_opacities[of])

    found, counts, going = survey(begin, len(rows), options, cameras), Counter[str](), [np.zeros(0, bool)]
    for leaves in begin():
        more, dropped = found.decide(leaves)
        counts.update(more)
        going.append(dropped)
    return dict(counts), np.concatenate(going)


def _middle(begin: Callable[[], Iterable[Array]], num_points: int) -> tuple[Float64[Array, "3"], float]:
    """The median of points along each axis, and the distance from there that holds half of them."""

    def along(axis: int) -> Iterator[Array]:
        return (points[:, axis] for points in begin())

    def distances() -> Iterator[Array]:
        return (_nearest(points, [centre]) for points in begin())

    centre = np.array([median_of(partial(along, axis), num_points) for axis in range(3)])
    return centre, max(median_of(distances, num_points), LEAST_RADIUS)


def _nearest(points: Array, others: Iterable[Array]) -> Float64[Array, "n"]:
    """Distance of each point to the nearest of some others."""
    nearest = np.full(len(points), np.inf)
    for other in others:
        np.minimum(nearest, np.linalg.norm(points - other, axis=1), out=nearest)
    return nearest


def _cubes_of(means: Array, centre: Array, edge: float) -> Int64[Array, "n"]:
    """The key of the cube that each point is in."""
    cells = np.clip(np.floor((means - centre) / edge), -REACH + 2, REACH - 2).astype(np.int64) + REACH
    return np.asarray((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2])


def _occupied(
    begin: Callable[[], Iterable[Leaves]], centre: Array, edge: float
) -> tuple[Int64[Array, "m"], Int64[Array, "m"]]:
    """The keys of the cubes with a leaf that is opaque enough, ascending, and how many such leaves each has."""
    keys, counts, waiting = np.zeros(0, np.int64), np.zeros(0, np.int64), list[tuple[Array, Array]]()
    for leaves in begin():
        opaque = leaves.logit_opacities >= math.log(OCCUPIED / (1 - OCCUPIED))
        waiting.append(np.unique(_cubes_of(leaves.means[opaque].astype(np.float64), centre, edge), return_counts=True))
        if sum(len(own) for own, _ in waiting) > max(len(keys), ROWS_AT_ONCE):
            keys, counts = _added([(keys, counts), *waiting])
            waiting.clear()
    return _added([(keys, counts), *waiting])


def _added(parts: Sequence[tuple[Array, Array]]) -> tuple[Int64[Array, "m"], Int64[Array, "m"]]:
    """Keys and counts of which some keys are in several parts."""
    keys, place = np.unique(np.concatenate([keys for keys, _ in parts]), return_inverse=True)
    counts = np.zeros(len(keys), np.int64)
    np.add.at(counts, place, np.concatenate([counts for _, counts in parts]))
    return keys, counts


def _without_floaters(cubes: Array, counts: Array, smallest_piece: float) -> Int64[Array, "m"]:
    """The cubes whose piece has enough leaves, or the most of all."""
    if len(cubes) == 0:
        return np.asarray(cubes)
    pieces = _pieces(cubes)
    leaves_of_piece = np.bincount(pieces, weights=counts, minlength=len(cubes))
    stays = leaves_of_piece >= smallest_piece * counts.sum()
    stays[np.argmax(leaves_of_piece)] = True
    return np.asarray(cubes[stays[pieces]])


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
