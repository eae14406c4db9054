"""Curves on the processor: those of ``reference/curves.py``, in float64, rounded once to float32."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int32, Int64

__all__ = ["MOMENTS", "add_shown", "fit_curves", "fit_curves_above", "root_moments"]

MOMENTS = 13
"""Numbers that say what the leaves below a node are together: mean, covariance, sums of opacities and of masses."""


def fit_curves(
    gaussians: Gaussians,
    subtree_end: Int32[Array, "n"],
    seen: Float32[Array, "n"],
    dilation_share: float,
    extents: Float32[Array, "n"],
    *,
    kept_extent: float = 0.0,
    kept_dilation: float = 0.0,
    least_dilation: float = 0.0,
    threads: int = 0,
) -> tuple[Gaussians, Float32[Array, "n 4"]]:
    """The Gaussians with other inner nodes, and the curve of each row; the given Gaussians stay as they are."""
    fitted, curves = _room_for(gaussians)
    limits = kept_extent, kept_dilation, least_dilation
    _core.fit_curves(fitted, subtree_end, seen, dilation_share, extents, *limits, curves, threads)
    return fitted, curves


def root_moments(
    gaussians: Gaussians,
    subtree_end: Int32[Array, "n"],
    num_roots: int,
    *,
    seen: Float32[Array, "n"] | None = None,
    below: Float64[Array, "l m"] | None = None,
    threads: int = 0,
) -> Float64[Array, "r m"]:
    """What the leaves below each root are together: of leaves with their visibilities, or of ``below`` each leaf."""
    moments = np.empty((num_roots, MOMENTS))
    _core.root_moments(gaussians, subtree_end, seen, below, moments, threads)
    return moments


def add_shown(
    log_scales: Float32[Array, "n 3"],
    logit_opacities: Float32[Array, "n"],
    seen: Float32[Array, "n"],
    first: int,
    spans: tuple[Int64[Array, "i"], Int64[Array, "i"]],
    dilations: Float64[Array, "i"],
    sums: Float64[Array, "i 2"],
    *,
    threads: int = 0,
) -> None:
    """Add what leaves show to the ``sums`` of the nodes above them: the leaves ``first`` and on of a list.

    ``spans`` say where the leaves below each node begin and end in that list.
    """
    _core.add_shown(log_scales, logit_opacities, seen, first, *spans, dilations, sums, threads)


def fit_curves_above(
    gaussians: Gaussians,
    subtree_end: Int32[Array, "n"],
    below: Float64[Array, "l m"],
    dilation_share: float,
    extents: Float32[Array, "n"],
    sums: Float64[Array, "i 2"],
    *,
    least_dilation: float = 0.0,
    threads: int = 0,
) -> tuple[Gaussians, Float32[Array, "n 4"]]:
    """As `fit_curves`, of rows whose leaves stand for others, given what these show: the bits of all rows together.

    ``below`` has the moments of what each leaf stands for (`root_moments`).
    """
    fitted, curves = _room_for(gaussians)
    _core.fit_curves_above(fitted, subtree_end, below, dilation_share, least_dilation, extents, sums, curves, threads)
    return fitted, curves


def _room_for(gaussians: Gaussians) -> tuple[Gaussians, Float32[Array, "n 4"]]:
    """A copy to be overwritten, but for the harmonics, and curves to be filled."""
    columns = ("means", "quats", "log_scales", "logit_opacities")
    fitted = Gaussians(**{name: getattr(gaussians, name).copy() for name in columns}, sh=gaussians.sh)
    return fitted, np.empty((len(gaussians), 4), np.float32)
