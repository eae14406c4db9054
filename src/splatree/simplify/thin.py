"""Thinning: fewer Gaussians that look alike, by pairs (simplify/pairs.py) or by a radius.

Radius thinning leaves no two representatives closer than r and merges each other one into its nearest.
The scheme takes Gaussians in the order of importance; one that has no earlier representative within r becomes one, the others
join theirs (kernels/reference/thin.py), then each group is merged (kernels/reference/merge.py). Cost: one radix sort and
O(n) for a radius; a count is found by about six of them, without merging.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.kernels.cpu.build import thin as kernel
from splatree.progress import task
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import check_threads, given
from splatree.scene.scene import Scene
from splatree.scene.thinning import Groups, ThinOptions
from splatree.shapes import Array, Float32, Int32
from splatree.simplify.merge import check_finite, importance_of, merge
from splatree.simplify.pairs import merge_pairs

__all__ = ["Thinned", "auto_radius", "linear_colors", "query_rows", "radius_of_count", "radius_of_spacing", "thin"]

COUNT_TOLERANCE = 0.01
"""How near to the wanted count a search for the radius comes, relative."""

NUM_QUERIES = 2048
"""Gaussians whose nearest neighbour is looked up for `auto`: the median of so many is within 3 % of the scene's."""


@dataclass(frozen=True, eq=False)
class Thinned:
    """A thinned scene, and how it came about.

    Example:
        >>> thinned = st.thin(st.read("city.ply"), st.ThinOptions(keep=0.5))
        >>> len(thinned) == len(thinned.groups)
        True
    """

    scene: Scene
    """A flat scene: one Gaussian for each group, in the order of their representatives' rows."""
    groups: Groups
    """Which Gaussians of the input each one stands for; the input is counted without merged nodes."""
    radius: float | None
    """r, world units, as given or found; None for `pairs`."""
    options: ThinOptions
    """The rules that were followed, with method and merge rules filled in."""

    def __len__(self) -> int:
        return len(self.scene)


@checked
def thin(scene: Scene, options: ThinOptions | None = None, *, threads: int = 0) -> Thinned:
    """Make a scene of fewer Gaussians that looks alike: to a radius, a share or a count.

    `pairs` meets a count exactly. `radius` meets a count to 1 % where the scene allows: duplicates are always merged, and colours
    that differ by more than ``color_radius`` never are. How Gaussians are merged follows the mode of the scene.

    Args:
        scene: any scene. Of a scene with levels only the leaves count.
        options: how far to thin and by which rules; None: to the radius `auto`.
        threads: threads to use; 0: all. The result is the same for any number.

    Returns:
        The thinned scene, and which Gaussians each of its own stands for.

    Raises:
        InputError: NaN or infinity in the Gaussians, or a count that the colours do not allow.

    Source:
        docs/explanation/thin.md.

    Example:
        >>> thinned = st.thin(st.read("city.ply"), st.ThinOptions(count=100))
        >>> len(thinned.scene)
        100
    """
    options = given(options, ThinOptions, "thin: options")
    check_threads(threads)
    gaussians = _leaves_of(scene)
    check_finite(gaussians)
    count = options.count
    if options.keep is not None:
        count = max(1, round(options.keep * len(gaussians)))
    method = options.chosen_method
    if method == "pairs" and count is not None:  # which it has: a count is all that `pairs` meets
        options = dataclasses.replace(options, method=method, merge=options.merge.resolved(scene.mode, of_pairs=True))
        merged, groups = merge_pairs(gaussians, count, options, mode=scene.mode, threads=threads)
        return Thinned(_flat(scene, merged), groups, None, options)
    options = dataclasses.replace(options, method=method, merge=options.merge.resolved(scene.mode))
    space = _Space(gaussians, options, threads)
    with task("thin", 3) as advance:
        if count is not None:
            radius = space.radius_of(count)
        elif isinstance(options.radius, float | int):
            radius = float(options.radius)
        else:
            radius = auto_radius(gaussians, threads=threads)
        advance(1)
        groups = space.groups(radius)
        advance(1)
        merged = merge(gaussians, groups, options.merge, mode=scene.mode, threads=threads)
        advance(1)
    return Thinned(_flat(scene, merged), groups, radius, options)


def _leaves_of(scene: Scene) -> Gaussians:
    is_leaf = scene.tree.is_leaf
    return scene.gaussians if is_leaf.all() else scene.gaussians.take(is_leaf)


def _flat(scene: Scene, merged: Gaussians) -> Scene:
    """The merged Gaussians, drawn as the scene is; what its provenance says of levels and clusters no longer holds."""
    metadata = {key: value for key, value in scene.source.metadata.items() if key not in ("levels", "clusters")}
    source = dataclasses.replace(scene.source, metadata=metadata)
    flat = Scene.flat(merged, mode=scene.mode, source=source)
    return dataclasses.replace(flat, threshold=scene.threshold, tile_rule=scene.tile_rule)


def auto_radius(gaussians: Gaussians, *, threads: int = 0) -> float:
    """1.5 × the median distance to the nearest neighbour that is not at the same place, of an even sample of rows.

    0 if all Gaussians are at one place.
    """
    means, n = gaussians.means, len(gaussians)
    if n < 2:
        return 0.0
    queries = query_rows(n)

    def nearest(edge: float) -> Array:
        return kernel.nearest_distances(means, queries, edge=edge, threads=threads)

    widest = float(np.max(np.ptp(means.astype(np.float64), axis=0)))
    return radius_of_spacing(means[queries], n, widest, nearest)


def query_rows(num_rows: int) -> Int32[Array, "q"]:
    """The rows whose nearest neighbours `auto_radius` looks up."""
    return np.unique(np.linspace(0, num_rows - 1, NUM_QUERIES).astype(np.int32 if num_rows < 2**31 else np.int64))


def radius_of_spacing(
    sample: Float32[Array, "q 3"], num_rows: int, widest: float, nearest: Callable[[float], Array]
) -> float:
    """The radius that `auto_radius` finds, of a scene that need not be in memory.

    Args:
        sample: means of the rows that `query_rows` names.
        num_rows: rows of the scene.
        widest: the longest side of the box around all means, world units.
        nearest: given an edge, the distance of each of the sample to its nearest other row if that is at most the edge, else
            infinity.
    """
    n, sample = num_rows, sample.astype(np.float64)
    span = float(np.max(np.quantile(sample, 0.99, axis=0) - np.quantile(sample, 0.01, axis=0)))
    if widest == 0:
        return 0.0
    edge = float((span or widest) / np.sqrt(n))
    while True:
        distances = nearest(edge)
        apart = distances[distances > 0]
        median = float(np.median(apart)) if len(apart) else 0.0
        if np.isfinite(median) and median > 0:
            return 1.5 * median
        if edge > 2 * widest:  # each sampled Gaussian has a twin at its place
            return 1.5 * widest / n
        edge *= 4


def linear_colors(gaussians: Gaussians) -> Float32[Array, "n 3"]:
    """DC colour less ½, linear RGB: differences are all that thinning looks at."""
    return np.ascontiguousarray(gaussians.sh[:, 0] * np.float32(SH_C0))


class _Space:
    """What distances are measured in: positions, colours, importance."""

    def __init__(self, gaussians: Gaussians, options: ThinOptions, threads: int) -> None:
        self.gaussians = gaussians
        self.colors = linear_colors(gaussians)
        self.importance = importance_of(gaussians, options.importance)
        self.color_radius = np.inf if options.color_radius is None else options.color_radius
        self.threads = threads

    def groups(self, radius: float) -> Groups:
        return kernel.thin(
            *(self.gaussians.means, self.colors, self.importance),
            radius=radius,
            color_radius=self.color_radius,
            threads=self.threads,
        )

    def count(self, radius: float) -> int:
        return kernel.count_representatives(
            *(self.gaussians.means, self.colors, self.importance),
            radius=radius,
            color_radius=self.color_radius,
            threads=self.threads,
        )

    def radius_of(self, count: int) -> float:
        """The radius that leaves ``count`` representatives."""
        if count >= len(self.gaussians):
            return 0.0
        widest = float(np.max(np.ptp(self.gaussians.means.astype(np.float64), axis=0)))
        first = auto_radius(self.gaussians, threads=self.threads)
        return radius_of_count(count, self.count, len(self.gaussians), first, widest, self.color_radius)


def radius_of_count(
    wanted: int, count: Callable[[float], int], num_rows: int, first: float, widest: float, color_radius: float
) -> float:
    """The radius that leaves a count, of a scene that need not be in memory.

    Bisection on log r, by the secant where it has two ends.

    Args:
        wanted: representatives to be left.
        count: how many a radius leaves.
        num_rows: rows of the scene.
        first: `auto_radius` of the scene, world units.
        widest: the longest side of the box around all means, world units.
        color_radius: the distance in colour that counts as much as the radius.

    Raises:
        InputError: colours do not allow so few.
    """
    if wanted >= num_rows or first == 0:  # 0: all at one place
        return 0.0
    radius, best, best_error = first, 0.0, np.inf
    low = high = None  # (log r, log count) with too many and with too few left
    for _ in range(48):
        found = count(radius)
        error = abs(found - wanted) / wanted
        if error < best_error:
            best, best_error = radius, error
        if error <= COUNT_TOLERANCE:
            return radius
        here = (np.log(radius), np.log(found / wanted))
        if found > wanted:
            low = here
            if radius > 2 * np.sqrt(3) * widest:
                raise InputError(
                    f"count: found at least {found} Gaussians at any radius, wanted {wanted}: colours farther apart than "
                    f"color_radius = {color_radius} never merge; raise color_radius or leave colour out"
                )
        else:
            high = here
        if low is None or high is None:
            # On surfaces the count falls with r²; a little more, so that the ends are soon on either side.
            step = 0.6 * here[1]
            radius *= float(np.exp(np.sign(step) * max(abs(step), 0.1)))
        else:
            share = np.clip(low[1] / (low[1] - high[1]), 0.1, 0.9)
            radius = float(np.exp(low[0] + share * (high[0] - low[0])))
            if high[0] - low[0] < 1e-9:
                break
        if radius < 1e-30:
            return 0.0
    return best
