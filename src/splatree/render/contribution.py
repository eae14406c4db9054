"""How much the pairs of splat and tile contribute to a picture: KPC and GTC.

The contribution of a pair is the light that its splat adds to the tile, in pixels (FilterGS 2026, Eq. 5; KPC):

    K = Σ_px α T        over the tile's pixels, T the transmittance before the splat

and the contribution of a tile the mean over its list of n pairs, of a view the mean over its tiles, of a scene the mean over its
views (Eq. 6, 7, 8; GTC):

    G = Σ K / n,   Ḡ_v = mean over tiles of G,   Ḡ = mean over views of Ḡ_v

At a pixel Σ_k α_k T_k telescopes to 1 − T_final, which is the picture's alpha. So Σ K of a tile is the sum of its alpha, and GTC
costs one pass over the pixels, nothing a pair; K of each pair is an output of the blend only where a histogram asks for it::

    frame = trace(scene, camera)
    tile_contributions(frame).mean()                             # Ḡ_v
    frame = trace(scene, camera, wanted=Wanted(contributions=True))
    contribution_histogram([frame.contributions])                # Fig. 6b

G depends on how lists are made, because n counts the pairs that contribute nothing: name the tile rule beside it. Variants:
``tiles`` `all` counts tiles without pairs as 0, as the paper's code does, so that sky lowers Ḡ_v; `non-empty` leaves them out.
``unit`` `pixels` is the paper's, 0 to 256; `coverage` divides by the pixels that the picture has in the tile, 0 to 1.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from splatree.constants import TILE_PX
from splatree.errors import InputError
from splatree.scene.arguments import checked
from splatree.scene.frame import Frame
from splatree.shapes import Array, Float32, Float64, Int64, check_fields

__all__ = [
    "ContributionHistogram",
    "TileContributions",
    "Tiles",
    "Unit",
    "contribution_histogram",
    "tile_contributions",
]

Tiles = Literal["all", "non-empty"]
"""Named sets of tiles that a view's contribution is the mean of."""

Unit = Literal["pixels", "coverage"]
"""Named units of a tile's contribution."""

REDUNDANT_PX = 0.01
"""Pairs of a smaller contribution are called redundant (FilterGS 2026, §3.3)."""

EDGES_PX = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)
"""Default edges of a histogram, px: fine where Fig. 6b of FilterGS is, doubling up to a whole tile."""


@dataclass(frozen=True, eq=False)
class TileContributions:
    """What the pairs of each tile of a view contribute together; tiles row by row.

    Example:
        >>> tiles = st.tile_contributions(st.trace(scene, camera))
        >>> 0 <= tiles.mean() <= 256
        True
    """

    sums_px: Float64[Array, "t"]
    """Σ K over the pairs of the tile, px."""
    num_pairs: Int64[Array, "t"]
    """Number of pairs in the tile's list."""
    num_pixels: Int64[Array, "t"]
    """Number of pixels of the picture in the tile, at most 256."""

    def __post_init__(self) -> None:
        check_fields(self)

    def each(self, *, unit: Unit = "pixels") -> Float64[Array, "t"]:
        """GTC of each tile (Eq. 6); 0 for tiles without pairs."""
        if unit not in get_args(Unit):
            raise InputError(f"unit: found {unit!r}, wanted one of {', '.join(get_args(Unit))}")
        sums = self.sums_px if unit == "pixels" else self.sums_px / self.num_pixels
        return np.asarray(sums / np.maximum(self.num_pairs, 1))

    def mean(self, *, tiles: Tiles = "all", unit: Unit = "pixels") -> float:
        """GTC of the view (Eq. 7); 0 if no tile counts."""
        if tiles not in get_args(Tiles):
            raise InputError(f"tiles: found {tiles!r}, wanted one of {', '.join(get_args(Tiles))}")
        values = self.each(unit=unit)
        counted = values if tiles == "all" else values[self.num_pairs > 0]
        return float(counted.mean()) if len(counted) else 0.0


@checked
def tile_contributions(frame: Frame) -> TileContributions:
    """Sum what the pairs of each tile contribute to a picture: the alpha of its pixels.

    Args:
        frame: a traced frame.

    Returns:
        Sums and counts of each tile, from which GTC follows.

    Source:
        FilterGS 2026, §3.3, Eq. 6 and 7; docs/explanation/contribution.md.

    Example:
        >>> st.tile_contributions(st.trace(scene, camera)).each().shape
        (12,)
    """
    alpha = frame.result.alpha
    starts = [np.arange(0, size, TILE_PX) for size in alpha.shape]
    rows = np.add.reduceat(alpha, starts[0], axis=0, dtype=np.float64)
    heights, widths = (np.diff(start, append=size) for start, size in zip(starts, alpha.shape, strict=True))
    return TileContributions(
        np.add.reduceat(rows, starts[1], axis=1).ravel(),
        np.diff(frame.bins.tile_start),
        np.outer(heights, widths).ravel(),
    )


@dataclass(frozen=True, eq=False)
class ContributionHistogram:
    """How many pairs contribute how much.

    Example:
        >>> frame = st.trace(scene, camera, wanted=st.Wanted(contributions=True))
        >>> found = st.contribution_histogram([frame.contributions])
        >>> found.num_pairs == frame.bins.num_pairs
        True
    """

    edges_px: Float64[Array, "e+1"]
    """Borders of the bins, px, ascending. A bin holds its lower border, the last bin also its upper one."""
    counts: Int64[Array, "e"]
    """Number of pairs in each bin."""
    num_pairs: int
    """Number of all pairs, in a bin or not."""
    num_used: int
    """Number of pairs that added light to a pixel."""
    num_redundant: int
    """Number of pairs that contribute less than 0.01 px, those without any contribution included."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def used_ratio(self) -> float:
        """Share of all pairs that added light to a pixel."""
        return self.num_used / self.num_pairs if self.num_pairs else 0.0

    @property
    def redundant_ratio(self) -> float:
        """Share of all pairs that contribute less than 0.01 px."""
        return self.num_redundant / self.num_pairs if self.num_pairs else 0.0


@checked
def contribution_histogram(
    contributions: Iterable[Float32[Array, "m"] | None], edges_px: Iterable[float] = EDGES_PX
) -> ContributionHistogram:
    """Count the pairs of one or more frames by what they contribute.

    Every pair counts, in ``num_used`` too, however large its contribution.

    Args:
        contributions: `Frame.contributions` of frames that were traced with ``Wanted(contributions=True)``, px.
        edges_px: borders of the bins, px, ascending.

    Returns:
        Pairs in each bin, and how many were used or redundant.

    Raises:
        InputError: a frame was traced without contributions, or the borders do not ascend.

    Source:
        FilterGS 2026, Eq. 5 and Figure 6b; docs/explanation/contribution.md.

    Example:
        >>> frame = st.trace(scene, camera, wanted=st.Wanted(contributions=True))
        >>> st.contribution_histogram([frame.contributions]).used_ratio <= 1
        True
    """
    edges = np.array(list(edges_px), np.float64)
    if len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise InputError(f"edges_px: found {edges.tolist()}, wanted at least two, ascending")
    counts = np.zeros(len(edges) - 1, np.int64)
    num_pairs = num_used = num_redundant = 0
    for values in contributions:
        if values is None:
            raise InputError(
                "contributions: found None, wanted those of a frame; trace it with Wanted(contributions=True)"
            )
        counts += np.histogram(values, edges)[0]
        num_pairs += len(values)
        num_used += int(np.count_nonzero(values))
        num_redundant += int(np.count_nonzero(values < REDUNDANT_PX))
    return ContributionHistogram(edges, counts, num_pairs, num_used, num_redundant)
