"""Draw what nearer Gaussians hide more coarsely.

From near by, half of the Gaussians in view show less than a fiftieth of what they would show alone. A cut by size draws them as
finely as the others. So a coarser cut C′ of the view, at τ′ > τ_R, is drawn first, at a quarter of its size. It tells for each of
its nodes u the share of it that is seen, of its splat with opacity α₀ and covariance Σ′ on the image:

    t(u) = Σ α T / (2π α₀ √det Σ′), at most 1,    the sum over the pixels, T the light that is left before u

Then the cut is that of the radii (kernels/reference/select.py, where any radii give a cut)

    R′(v) = 3 R(v) max(t(u), 1/1000)^0.4 in the subtree of a node u of C′,    R′(v) = 3 R(v) elsewhere,

so what is hidden may be larger on the screen, up to the nodes of C′ themselves, and what is seen is finer. Nothing is left out:
where the first picture was wrong, nodes of C′ are drawn. A node of which the share t is seen shows that share of its error. With
errors that grow as τ^q and numbers that fall as 1/τ², the least squared error for a number of nodes has τ ~ t^(−1 / (1 + q)): a
power between a half (q = 1) and a third (q = 2). With the factor 3 a picture by a τ_R of 4 px is about as near to all leaves as
without occlusion (docs/explanation/select.md).

All rows above C′ are larger than τ′. So one pass over the limits from τ_R / 3 to τ′ has all that can be drawn (`CutRange`), and
its limits are multiplied by those factors. τ′ is 2 τ_R; a budget takes C′ with a quarter of it.

Cost: one coarser cut, its picture at a sixteenth of the pixels, and a pass over a range instead of one limit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.frame.question import limit_of, pixel_error_of
from splatree.lod.budget import LEAST_PX, RangeAt, least_limit, spread_of
from splatree.scene.frame import CutRange, Splats, TileBins
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.options import SelectOptions
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, check_fields

__all__ = ["Cover", "cover_of", "eased", "first_look", "select_eased", "shares_seen"]

SIZE_OF_LOOK: Final = 0.25
"""Size of the first picture over that of the view."""

COARSER: Final = 2.0
"""τ′ over τ_R."""

AS_BEFORE: Final = 3.0
"""R′ over R where all of a node is seen."""

SHARE_OF_LOOK: Final = 4
"""Of a budget, one node of so many is in C′."""

FINER: Final = 2.0
"""Where a guess of the τ_R of a budget was too coarse, so many times finer ones are looked at."""

LEAST_SHARE: Final = 1e-3
"""Nodes of which less is seen count as this."""

POWER: Final = 0.4
"""Of the share that is seen, by which radii fall."""

Chosen = tuple[Int32[Array, "v"], int, float]
"""Rows, how many were looked at, and τ_R, px."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Subtrees of which the first picture tells how much is seen."""

    rows: Int32[Array, "u"]
    """Their topmost rows, ascending."""
    ends: Int32[Array, "u"]
    """Where they end."""
    factors: Float32[Array, "u"]
    """By which the radii in them are multiplied, R′ / 3 R, at most 1."""

    def __post_init__(self) -> None:
        check_fields(self)

    def of(self, rows: Int32[Array, "v"]) -> Float32[Array, "v"]:
        """The factor of each of some rows, ascending; 1 in no subtree."""
        factors = np.ones(len(rows), np.float32)
        first, last = np.searchsorted(rows, self.rows), np.searchsorted(rows, self.ends)
        counts = last - first
        inside = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        factors[inside] = np.repeat(self.factors, counts)
        return factors


def select_eased(
    plain: Callable[[SelectOptions], Chosen],
    range_at: RangeAt,
    look: Callable[[Int32[Array, "u"]], Cover],
    options: SelectOptions,
    *,
    every: int,
) -> Chosen:
    """The rows of the cut by R′, how many were looked at, and τ_R, px.

    Args:
        plain: the cut by R of some options.
        range_at: the cuts by R of a range of τ_R.
        look: what a picture of some rows tells of them.
        options: with the profile of the levels; a budget is met by raising τ_R.
        every: of so many blocks one is looked at to guess the τ_R of a budget.

    Raises:
        InputError: not even the roots in view meet the budget.
    """
    profile, smallest = options.resolved_profile, options.pixel_error / AS_BEFORE
    if options.budget is None:
        coarser = replace(options, pixel_error=COARSER * options.pixel_error)
    else:
        coarser = replace(options, pixel_error=smallest, budget=max(1, options.budget // SHARE_OF_LOOK))
    try:
        rows, visited, coarsest = plain(coarser)
    except InputError:  # so many roots are in view, or more than the whole budget
        return plain(options)
    if not smallest < coarsest < np.inf:
        return plain(options)
    cover = look(rows)

    def eased_at(finest: float, every: int = 1) -> CutRange:
        return eased(range_at(finest, coarsest, every), cover, is_squared=profile not in EXTENT_PROFILES)

    if options.budget is None:
        found = eased_at(smallest)
        return found.at(limit_of(smallest, profile)), visited + found.num_visited, options.pixel_error
    fine = smallest
    if every > 1:
        guess = least_limit(eased_at(smallest, every), options.budget / every)
        fine = max(smallest, pixel_error_of(guess or 0.0, profile) / spread_of(options.budget, every))
    while True:
        found = eased_at(fine)
        visited += found.num_visited
        limit = least_limit(found, options.budget)
        assert limit is not None  # at τ′ the cut by R′ is C′
        if fine == smallest and limit <= limit_of(fine, profile):
            return found.at(limit_of(fine, profile)), visited, options.pixel_error
        if limit >= limit_of(fine, profile):
            return found.at(limit), visited, AS_BEFORE * pixel_error_of(limit, profile)
        fine = smallest if fine < LEAST_PX else max(smallest, fine / FINER)


def eased(found: CutRange, cover: Cover, *, is_squared: bool) -> CutRange:
    """A range of cuts by R as one by R′ / 3; ``is_squared``: its limits are squares of radii."""
    factors = cover.of(found.rows)
    if is_squared:
        factors = factors * factors
    return CutRange(found.rows, found.enters * factors, found.leaves * factors, found.num_visited)


def first_look(view: View) -> View:
    """The view in which the share is found that is seen of each node."""
    wanted = replace(view.wanted, contributions=True, last_pair=False, median_depth=False, depth=False)
    camera = view.camera.scaled(SIZE_OF_LOOK)
    return replace(view, camera=camera, wanted=wanted, least_light=0.0, pixels="hard")


def shares_seen(splats: Splats, bins: TileBins, contributions: Float32[Array, "m"], view: View) -> Float32[Array, "v"]:
    """t of each splat: what it adds to the picture over what it would add alone, at most 1."""
    seen = np.bincount(bins.splat_from_pair, contributions, len(splats))
    a, c = splats.factors[:, 0].astype(np.float64), splats.factors[:, 2].astype(np.float64)
    alone = 2 * np.pi * splats.opacities / (a * c)
    size = np.array([view.camera.width, view.camera.height])
    low, high = splats.means_px - splats.half_sizes_px, splats.means_px + splats.half_sizes_px
    inside = (np.clip(high, 0, size) - np.clip(low, 0, size)) / np.maximum(
        high - low, 1e-6
    )  # of its box, along each side
    return np.asarray(np.minimum(seen / np.maximum(alone * inside.prod(axis=1), 1e-12), 1), np.float32)


def cover_of(
    splats: Splats, bins: TileBins, contributions: Float32[Array, "m"], view: View, subtree_end: Int32[Array, "n"]
) -> Cover:
    """What the first picture tells of the rows that are in it."""
    shares = shares_seen(splats, bins, contributions, view)
    factors = np.maximum(shares, LEAST_SHARE) ** np.float32(POWER)
    return Cover(splats.rows, subtree_end[splats.rows], factors.astype(np.float32))
