"""How much of each Gaussian can be seen, for thinning: what is hidden from everywhere is not worth a Gaussian.

In a trained scene many Gaussians lie behind others. Spending fewer of them on hidden parts gains as much as half as many more
Gaussians would (a city at a tenth, benchmarks/quality.py). kernels/reference/visibility.py defines the measure; this module
chooses its lengths from the scene. Cost: eight directions, about a microsecond a Gaussian.
"""

import numpy as np

from splatree.kernels.cpu.build.visibility import Sight, measure_visibilities
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.shapes import Array, Float32

__all__ = [
    "NUM_SAMPLES",
    "SIZE_SAMPLES",
    "as_counted",
    "full_sight",
    "median_size",
    "pixel_size_of",
    "relative",
    "sample_of",
    "sight_of",
    "visibilities_in",
    "visibilities_of",
]

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

SIZE_SAMPLES = 1 << 20
"""Rows of which medians and percentiles are taken at most."""


def visibilities_of(gaussians: Gaussians, *, threads: int = 0) -> Float32[Array, "n"]:
    """Visibilities relative to the 95th percentile, at most 1."""
    sight = sight_of(sample_of(gaussians.means, NUM_SAMPLES), len(gaussians), pixel_size_of(gaussians))
    seen = measure_visibilities(gaussians, sight, threads=threads)
    return relative(seen, full_sight(sample_of(seen, SIZE_SAMPLES)))


def sight_of(sample: Array, num_gaussians: int, pixel_size: float) -> Sight:
    """The lengths for a scene, from a sample of its means (n 3) and the size of its median Gaussian."""
    low, middle, high = np.quantile(sample.astype(np.float64), (0.02, 0.5, 0.98), axis=0)
    extent = float(np.max(high - low))
    cell = CELL_SIZE * pixel_size
    width = 64
    while width < 1.5 * extent / cell and 4 * width * width <= max(1 << 16, CELLS_PER_GAUSSIAN * num_gaussians):
        width *= 2
    return Sight(middle, max(cell, 1.5 * extent / width), REACH * extent or np.inf, width)


def full_sight(sample: Float32[Array, "s"]) -> float:
    """The visibility that counts as whole: the 95th percentile."""
    return float(np.quantile(sample, 0.95))


def relative(seen: Float32[Array, "n"], full: float) -> Float32[Array, "n"]:
    """Visibilities relative to one that counts as whole."""
    return np.asarray(np.clip(seen / np.float32(full), VISIBILITY_MIN, 1), np.float32)


def sample_of(values: Array, most: int) -> Array:
    """At most so many rows, at an even distance."""
    return values[:: len(values) // most + 1]


def visibilities_in(mode: Mode, gaussians: Gaussians, *, threads: int = 0) -> Float32[Array, "n"]:
    """What costs of pairs and weights are multiplied by in scenes of a mode."""
    if len(gaussians) == 0:
        return np.empty(0, np.float32)
    return as_counted(mode, visibilities_of(gaussians, threads=threads))


def as_counted(mode: Mode, visibilities: Float32[Array, "n"]) -> Float32[Array, "n"]:
    """What visibilities count in scenes of a mode."""
    # `optical` opacity counts what is hidden, too; with the root, what is seen stays in proportion to it.
    return visibilities if mode == "classic" else np.sqrt(visibilities)


def pixel_size_of(gaussians: Gaussians) -> float:
    """The median over all Gaussians, or a sample if there are many, of √(σ₁ σ₂), the two largest axes: world units."""
    return median_size(sample_of(gaussians.log_scales, SIZE_SAMPLES))


def median_size(log_scales: Float32[Array, "n 3"]) -> float:
    """The median of √(σ₁ σ₂), the two largest axes: world units."""
    x, y, z = log_scales.T
    largest_two = x + y + z - np.minimum(np.minimum(x, y), z)
    return float(np.exp(np.median(largest_two) / 2)) if len(log_scales) else 1.0
