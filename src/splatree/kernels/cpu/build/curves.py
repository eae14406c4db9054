"""Curves on the processor: those of ``reference/curves.py``, in float64, rounded once to float32."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int32

__all__ = ["fit_curves"]


def fit_curves(
    gaussians: Gaussians,
    subtree_end: Int32[Array, "n"],
    seen: Float32[Array, "n"],
    dilation_share: float,
    extents: Float32[Array, "n"] | None = None,
    *,
    kept_extent: float = 0.0,
    kept_dilation: float = 0.0,
    least_dilation: float = 0.0,
    threads: int = 0,
) -> tuple[Gaussians, Float32[Array, "n 4"]]:
    """The Gaussians with other inner nodes, and the curve of each row; the given Gaussians stay as they are."""
    columns = ("means", "quats", "log_scales", "logit_opacities")
    fitted = Gaussians(**{name: getattr(gaussians, name).copy() for name in columns}, sh=gaussians.sh)
    curves = np.empty((len(gaussians), 4), np.float32)
    limits = kept_extent, kept_dilation, least_dilation
    _core.fit_curves(fitted, subtree_end, seen, dilation_share, extents, *limits, curves, threads)
    return fitted, curves
