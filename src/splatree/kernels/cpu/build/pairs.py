"""Pairs on the processor: the partners of ``reference/pairs.py`` in float32, and the matching of the cheapest."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int32

__all__ = ["best_partners", "match_pairs"]


def best_partners(
    gaussians: Gaussians,
    weights: Float32[Array, "n"],
    visibilities: Float32[Array, "n"] | None = None,
    *,
    dilation: float,
    threads: int = 0,
) -> tuple[Int32[Array, "n"], Float32[Array, "n"], Float32[Array, "n"]]:
    """Each row's cheapest partner (−1 if it is alone), the cost, and the opacity of the two merged.

    Without ``visibilities`` all are seen whole.
    """
    n = len(gaussians)
    partner, costs, opacities = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.float32)
    _core.best_partners(gaussians, weights, visibilities, dilation, partner, costs, opacities, threads)
    return partner, costs, opacities


def match_pairs(
    partner: Int32[Array, "n"], costs: Float32[Array, "n"], max_pairs: int, *, threads: int = 0
) -> Int32[Array, "n"]:
    """The cheapest pairs, no row twice, at most ``max_pairs``: the row that stands for each row."""
    representative_from_row = np.empty(len(partner), np.int32)
    _core.match_pairs(partner, costs, max_pairs, representative_from_row, threads)
    return representative_from_row
