"""A step of the optimiser for the rows that were drawn: the definition.

Adam (Kingma 2015, Algorithm 1) with a count of steps for each row, so that a row that was just born starts right:

    m ← 0.9 m + 0.1 d,  v ← 0.999 v + 0.001 d²,  x ← x − rate · ramp · (m / (1 − 0.9ᵗ)) / (√(v / (1 − 0.999ᵗ)) + 1e-15)

Rows that were not drawn keep their moments (sparse Adam). A row's first ``ramp_steps`` steps are shorter, by the factor
ramp = min(1, t / ramp_steps). A row with a derivative that is not finite makes no step.
"""

import numpy as np

from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, Moments
from splatree.shapes import Array, Float32

__all__ = ["BETA_1", "BETA_2", "COLUMNS", "EPSILON", "step"]

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
"""The order of the columns in `Moments.values` and in the rates."""

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-15
"""Kingma 2015; ε as in Kerbl 2023, since derivatives are small."""


def step(
    gaussians: Gaussians,
    gradients: GaussianGradients,
    moments: Moments,
    rates: Float32[Array, "e"],
    *,
    ramp_steps: int = 1,
    threads: int = 0,
) -> None:
    """Change the columns of the Gaussians and the moments in place.

    Args:
        gaussians: their columns are written to.
        gradients: derivatives of the rows that were drawn, each row once.
        moments: as many rows as there are Gaussians.
        rates: of each number of a row, in the order of `Moments.values`; 0 for what is not learned.
        ramp_steps: steps until a row moves at the full rate.
        threads: not used.
    """
    rows = gradients.rows
    d = _packed(gradients, len(rows), moments.values.shape[2])
    rows, d = rows[np.isfinite(d).all(axis=1)], d[np.isfinite(d).all(axis=1)]
    moments.steps[rows] = np.minimum(moments.steps[rows].astype(np.int64) + 1, 65535)
    t = moments.steps[rows].astype(np.float64)[:, None]
    m = BETA_1 * moments.values[rows, 0] + (1 - BETA_1) * d
    v = BETA_2 * moments.values[rows, 1] + (1 - BETA_2) * d * d
    moments.values[rows, 0], moments.values[rows, 1] = m, v
    change = (m / (1 - BETA_1**t)) / (np.sqrt(v / (1 - BETA_2**t)) + EPSILON)
    change *= rates * np.minimum(1, t / ramp_steps)
    place = 0
    for name in COLUMNS:
        column = _flat(getattr(gaussians, name))
        column[rows] -= change[:, place : place + column.shape[1]]
        place += column.shape[1]


def _packed(gradients: GaussianGradients, num_rows: int, width: int) -> Array:
    """Derivatives side by side, as the moments lie."""
    parts = [_flat(getattr(gradients, name)).astype(np.float64) for name in COLUMNS]
    packed = np.zeros((num_rows, width))
    joined = np.concatenate(parts, axis=1)
    packed[:, : joined.shape[1]] = joined
    return packed


def _flat(column: Array) -> Array:
    """The numbers of a row side by side; a view, also of no rows."""
    return column.reshape(len(column), int(np.prod(column.shape[1:])))
