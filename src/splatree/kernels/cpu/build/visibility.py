"""Visibility on the processor: what ``reference/visibility.py`` defines, in float32."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64

__all__ = ["measure_visibilities"]


def measure_visibilities(
    gaussians: Gaussians, middle: Float64[Array, "3"], *, cell: float, reach: float, width: int, threads: int = 0
) -> Float32[Array, "n"]:
    """What others leave to be seen of each Gaussian, 0 to 1; ``width`` of the plane, a power of two of at least 64 cells."""
    assert width >= 64 and width & (width - 1) == 0
    visibilities = np.empty(len(gaussians), np.float32)
    _core.measure_visibilities(gaussians, middle, cell, reach, width, visibilities, threads)
    return visibilities
