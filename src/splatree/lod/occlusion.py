"""Draw with fewer nodes what nearer Gaussians hide.

From near by, half of the Gaussians in view show less than a fiftieth of what they would show alone. A cut by size draws them as
finely as the others. So a coarser cut C′ of the view, at τ′ > τ_R, is drawn first, at half of its size. It tells of each of its
nodes u how much of it is seen, L(u), and how much would be seen of it alone, L₀(u), both sums over the pixels:

    L(u) = Σ α T,    L₀(u) = 2π (α₀ − θ) √det Σ′,    T the light that is left before u, θ = 1/255 where splats end

and so of each node a that stands for some of C′ the share that is seen of it, t(a) = min(1, Σ L / Σ L₀). The cut is that of the
radii (kernels/reference/select.py, where any radii give a cut)

    R′(v) = 2 R(v) s(u) in the subtree of a node u of C′,    R′(v) = 2 R(v) elsewhere,
    ln s(u) = mean of 0.4 ln max(t(a), 1/1000) over the cuts of τ′ to 2 τ′, evenly in ln τ, a the node there that stands for u,

so what is hidden may be larger on the screen, up to the nodes of C′ themselves, and what is seen is finer. Nothing is left
out: where the first picture was wrong, nodes of C′ are drawn. The mean over cuts makes s change little at a time while the camera
moves. Without it whole subtrees would change their level when C′ takes a node in place of its children.

A node of which the share t is seen shows that share of its error. With errors that grow as τ^q and numbers that fall as 1/τ², the
least squared error for a number of nodes has τ ~ t^(−1 / (1 + q)): a power between a half (q = 1) and a third (q = 2). With the
factor 2 a picture by a τ_R of 4 px is about as near to all leaves as without occlusion (docs/explanation/select.md).

The first picture has to let through as much light as the picture does. Pixels twice as wide need splats that are blurred as much,
or they alias; but blurred splats as they are would hide four times as much where Gaussians are small. So a splat has its shape
and opacity at the full size, and is then blurred with its mass kept (`blurred`).

All rows above C′ are larger than τ′. So one pass over the limits from τ_R / 2 to τ′ has all that can be drawn (`CutRange`), and
its limits are multiplied by those factors. τ′ is 3 τ_R; a budget takes C′ with a third of it.

Cost: one coarser cut, its picture at a quarter of the pixels, and two passes over ranges instead of one limit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, DILATION_PX2
from splatree.errors import InputError
from splatree.kernels.cpu.frame.question import limit_of, pixel_error_of
from splatree.lod.budget import LEAST_PX, RangeAt, least_limit, spread_of
from splatree.scene.frame import CutRange, Splats, TileBins
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.options import SelectOptions
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Float64, Int32, check_fields

__all__ = ["Cover", "Light", "Look", "blurred", "cover_of", "eased", "first_look", "light_of", "select_eased"]

SIZE_OF_LOOK: Final = 0.5
"""Size of the first picture over that of the view. At a quarter a cut of 40 dB
takes 1 to 4 % of the leaves more, and the worst pop is 2 dB worse."""

COARSER: Final = 3.0
"""τ′ over τ_R."""

COARSEST: Final = 2.0
"""τ over τ′ of the coarsest cut in which shares are looked at."""

LEAST_PX2: Final = 1e-3
"""L₀ of nodes of which the first picture tells nothing, px²: nothing is taken to hide them."""

ADDED_PX2: Final = (1 - SIZE_OF_LOOK**2) * DILATION_PX2
"""By which the first picture is blurred: with the dilation of the full size, as much as any picture."""

AS_BEFORE: Final = 2.0
"""R′ over R where all of a node is seen."""

SHARE_OF_LOOK: Final = 3
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
class Light:
    """What the first picture shows of the nodes of C′ that are in it."""

    rows: Int32[Array, "u"]
    """The nodes, ascending."""
    seen: Float64[Array, "u"]
    """L: the light of each in the picture, px²."""
    alone: Float64[Array, "u"]
    """L₀: its light if it were alone, px²."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Cover:
    """Subtrees that are drawn more coarsely, as far as they are hidden."""

    rows: Int32[Array, "u"]
    """Their topmost rows, ascending."""
    ends: Int32[Array, "u"]
    """Where they end."""
    factors: Float32[Array, "u"]
    """s: by which the radii in them are multiplied, R′ / 2 R, at most 1."""

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


class Look(Protocol):
    """What a picture of the rows of C′ tells, by the cuts from its limit to another, where shares are looked at."""

    def __call__(self, rows: Int32[Array, "u"], coarser: CutRange, limits: tuple[float, float]) -> Cover: ...


def select_eased(
    plain: Callable[[SelectOptions], Chosen],
    range_at: RangeAt,
    look: Look,
    options: SelectOptions,
    *,
    every: int,
) -> Chosen:
    """The rows of the cut by R′, how many were looked at, and τ_R, px.

    Args:
        plain: the cut by R of some options.
        range_at: the cuts by R of a range of τ_R.
        look: what a picture of C′ tells.
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
    limits = limit_of(coarsest, profile), limit_of(COARSEST * coarsest, profile)
    cover = look(rows, range_at(coarsest, COARSEST * coarsest), limits)

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
    """A range of cuts by R as one by R′ / 2; ``is_squared``: its limits are squares of radii."""
    factors = cover.of(found.rows)
    if is_squared:
        factors = factors * factors
    return CutRange(found.rows, found.enters * factors, found.leaves * factors, found.num_visited)


def first_look(view: View) -> View:
    """The view in which the share is found that is seen of each node; its splats are those of the full size, before `blurred`."""
    wanted = replace(view.wanted, contributions=True, last_pair=False, median_depth=False, depth=False)
    return replace(
        view,
        camera=view.camera.scaled(SIZE_OF_LOOK),
        dilation_px2=SIZE_OF_LOOK**2 * view.dilation_px2,
        threshold=ALPHA_THRESHOLD,
        tile_rule="ellipse",
        pixels="hard",
        least_light=0.0,
        wanted=wanted,
    )


def blurred(splats: Splats, added_px2: float = ADDED_PX2) -> Splats:
    """Splats with so much more variance along both axes, px², and the opacity that keeps their mass."""
    a, b, c = splats.factors.T.astype(np.float64)
    xx, xy, yy = 1 / a**2 + (b / (a * c)) ** 2, -b / (a * c**2), 1 / c**2  # Σ′ = L⁻¹ L⁻ᵀ
    before = 1 / (a * c) ** 2
    after = before + added_px2 * (xx + yy) + added_px2**2
    xx, yy = xx + added_px2, yy + added_px2
    opacities = splats.opacities * np.sqrt(before / after)
    k = np.sqrt(2 * np.log(np.maximum(opacities / ALPHA_THRESHOLD, 1)))
    a = np.sqrt(yy / after)
    records = splats.records.copy()
    records[:, 2:5] = np.stack([a, -a * xy / yy, 1 / np.sqrt(yy)], axis=1)
    records[:, 5], records[:, 6] = opacities, np.log2(opacities)
    records[:, 11:13] = k[:, None] * np.sqrt(np.stack([xx, yy], axis=1))
    return replace(splats, records=records)


def light_of(splats: Splats, bins: TileBins, contributions: Float32[Array, "m"], view: View) -> Light:
    """What a picture shows of its splats, and would show of each alone."""
    seen = np.bincount(bins.splat_from_pair, contributions, len(splats)).astype(np.float64)  # of no pairs it counts
    a, c = splats.factors[:, 0].astype(np.float64), splats.factors[:, 2].astype(np.float64)
    alone = 2 * np.pi * np.maximum(splats.opacities - ALPHA_THRESHOLD, 0) / (a * c)
    size = np.array([view.camera.width, view.camera.height])
    low, high = splats.means_px - splats.half_sizes_px, splats.means_px + splats.half_sizes_px
    inside = (np.clip(high, 0, size) - np.clip(low, 0, size)) / np.maximum(high - low, 1e-6)  # of its box, by sides
    return Light(splats.rows, seen, alone * inside.prod(axis=1))


def cover_of(light: Light, coarser: CutRange, limits: tuple[float, float], subtree_end: Int32[Array, "n"]) -> Cover:
    """The subtrees of the nodes of C′ and their factors s: means over the cuts between two limits, from that of C′ on."""
    num_nodes = len(light.rows)
    first, last = np.searchsorted(light.rows, coarser.rows), np.searchsorted(light.rows, subtree_end[coarser.rows])

    def below(of_nodes: Float64[Array, "u"]) -> Float64[Array, "a"]:
        """Sums over the nodes of C′ that each row of the cuts stands for."""
        sums = np.concatenate([[0.0], np.cumsum(of_nodes)])
        return np.asarray(sums[last] - sums[first])

    def above(of_rows: Float64[Array, "a"]) -> Float64[Array, "u"]:
        """Sums over the rows of the cuts that stand for each node of C′."""
        steps = np.bincount(first, of_rows, num_nodes + 1) - np.bincount(last, of_rows, num_nodes + 1)
        return np.asarray(np.cumsum(steps)[:num_nodes])

    seen, alone = below(light.seen), below(light.alone)
    shares = np.where(alone > LEAST_PX2, np.clip(seen / np.maximum(alone, LEAST_PX2), LEAST_SHARE, 1), 1.0)
    spans = np.log(np.minimum(coarser.leaves, limits[1]) / np.maximum(coarser.enters, limits[0]))
    spans = np.maximum(spans, 0).astype(np.float64)
    means = above(spans * np.log(shares)) / np.maximum(above(spans), 1e-9)
    factors = np.exp(POWER * np.clip(means, np.log(LEAST_SHARE), 0))
    return Cover(light.rows, subtree_end[light.rows], factors.astype(np.float32))
