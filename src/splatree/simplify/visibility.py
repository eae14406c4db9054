"""How much of each Gaussian can be seen, for thinning: what is hidden from everywhere is not worth a Gaussian.

In a trained scene many Gaussians lie behind others. Spending fewer of them on hidden parts gains as much as half as many more
Gaussians would (a city at a tenth, benchmarks/quality.py). kernels/reference/visibility.py defines the measure; this module
chooses its lengths from the scene. Cost: eight directions, about a microsecond a Gaussian.
"""

import numpy as np

from splatree.kernels.cpu.build.visibility import measure_visibilities
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.shapes import Array, Float32

__all__ = ["pixel_size_of", "visibilities_in", "visibilities_of"]

CELL_SIZE = 4.0
"""Edge of a cell, in sizes of the median Gaussian: from 3 to 6 the thinned city differs by less than 0.05 dB (a trial)."""

REACH = 0.1
"""Distance after which what hides is forgotten, as a share of the scene's extent: a viewer may come as near."""

VISIBILITY_MIN = 0.01
"""Smallest visibility relative to the largest: a hidden Gaussian still has a place."""

CELLS_PER_GAUSSIAN = 16
"""Most cells of a plane, as a multiple of the Gaussians: in wider scenes cells become coarser."""

NUM_SAMPLES = 1 << 16
"""Rows whose means give the scene's extent."""


def visibilities_of(gaussians: Gaussians, *, threads: int = 0) -> Float32[Array, "n"]:
    """Visibilities relative to the 95th percentile, at most 1."""
    n = len(gaussians)
    sample = gaussians.means[:: n // NUM_SAMPLES + 1].astype(np.float64)
    low, middle, high = np.quantile(sample, (0.02, 0.5, 0.98), axis=0)
    extent = float(np.max(high - low))
    cell = CELL_SIZE * pixel_size_of(gaussians)
    width = 64
    while width < 1.5 * extent / cell and 4 * width * width <= max(1 << 16, CELLS_PER_GAUSSIAN * n):
        width *= 2
    cell = max(cell, 1.5 * extent / width)
    seen = measure_visibilities(
        gaussians, middle, cell=cell, reach=REACH * extent or np.inf, width=width, threads=threads
    )
    return np.asarray(np.clip(seen / np.quantile(seen, 0.95), VISIBILITY_MIN, 1), np.float32)


def visibilities_in(mode: Mode, gaussians: Gaussians, *, threads: int = 0) -> Float32[Array, "n"]:
    """What costs of pairs and weights are multiplied by in scenes of a mode."""
    if len(gaussians) == 0:
        return np.empty(0, np.float32)
    visibilities = visibilities_of(gaussians, threads=threads)
    # `optical` opacity counts what is hidden, too; with the root, what is seen stays in proportion to it.
    return visibilities if mode == "classic" else np.sqrt(visibilities)


def pixel_size_of(gaussians: Gaussians) -> float:
    """The median over all Gaussians of √(σ₁ σ₂), the two largest axes: world units."""
    x, y, z = gaussians.log_scales.T
    largest_two = x + y + z - np.minimum(np.minimum(x, y), z)
    return float(np.exp(np.median(largest_two) / 2)) if len(gaussians) else 1.0
