"""A level of growth by pairs on the processor: glue over level.cpp. What may merge is said in lod/present.py."""

from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.cpu.build.partners import Partners
from splatree.scene.gaussians import Gaussians
from splatree.scene.thinning import MergeOptions
from splatree.shapes import Array, Bool, Float32, Int32

__all__ = ["LevelLimits", "find_partners", "merge_level"]


@dataclass(frozen=True)
class LevelLimits:
    """Which pairs a level merges, and in how many rounds."""

    cost: float
    """What merging a pair may change, squared, world units²."""
    sigma: float
    """Longest axis of what it may become, standard deviation in world units."""
    small_sigma: float
    """A pair that becomes no longer than this is merged whatever it changes, world units; below 0: none is."""
    saturated: float
    """A fitted opacity from here on gives way to the merge's own rule; 0: the rule's are taken everywhere."""
    dilation: float
    """Variance added to every axis where costs are taken, world units²."""
    round_share: float
    """Pairs that a round merges at most, as a share of the Gaussians that are left."""
    last_share: float
    """A round that merges a smaller share is the last."""
    num_enough: int
    """So few Gaussians need no further round."""


def find_partners(
    gaussians: Gaussians,
    weights: Float32[Array, "n"],
    visibilities: Float32[Array, "n"],
    partners: Partners,
    dilation: float,
    *,
    threads: int = 0,
) -> None:
    """Find the partners that are stale, in place, by costs with that dilation: `merge_level` would find the same ones first."""
    _core.find_partners(gaussians, weights, visibilities, partners, dilation, threads)


def merge_level(
    gaussians: Gaussians,
    weights: Float32[Array, "n"],
    visibilities: Float32[Array, "n"],
    partners: Partners,
    merge: MergeOptions,
    *,
    added: float,
    limits: LevelLimits,
    is_frozen: Bool[Array, "n"],
    threads: int = 0,
) -> Int32[Array, "n"]:
    """Merge pairs until few may merge, in place: of two that become one, the first row becomes both. ``merge`` resolved.

    Frozen rows stay as they are, and so does each row while its cheapest partner is frozen.

    Returns:
        The row that each has become part of. Other rows than these hold nothing any more.
    """
    row_from_row = np.empty(len(gaussians), np.int32)
    frozen = is_frozen.view(np.uint8)
    _core.merge_level(
        *(gaussians, weights, visibilities, partners, merge, added, limits, frozen, row_from_row, threads)
    )
    return row_from_row
