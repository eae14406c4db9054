"""A step of the optimiser: glue over optimise.cpp; kernels/reference/optimise.py is the definition."""

from functools import cache

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.optimise import BETA_1, BETA_2, EPSILON
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, Moments
from splatree.shapes import Array, Float32

__all__ = ["corrections", "step"]


def step(
    gaussians: Gaussians,
    gradients: GaussianGradients,
    moments: Moments,
    rates: Float32[Array, "e"],
    *,
    ramp_steps: int = 1,
    threads: int = 0,
) -> None:
    """Change the columns of the Gaussians and the moments in place."""
    settings = [1 / ramp_steps, BETA_1, BETA_2, EPSILON]
    _core.step_rows(gaussians, gradients, moments.values, moments.steps, rates, corrections(), settings, threads)


@cache
def corrections() -> Float32[Array, "65536 2"]:
    """1 / (1 − βᵗ) of both moments, for each number t of steps."""
    t = np.maximum(np.arange(65536), 1)[:, None]
    return np.asarray(1 / (1 - np.array([BETA_1, BETA_2]) ** t), np.float32)
