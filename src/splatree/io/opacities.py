"""Linear opacities of files into logits, also those above 1 with which level-of-detail formats mark merged Gaussians.

A merged Gaussian of opacity A > 1 is drawn by its format with a plateau: α(r) = min(1, A e^(−r²/2σ²)) in Hierarchical 3DGS (Kerbl
2024), 1 − (1 − e^(−r²/2σ²))^A in Spark. Both have a peak of 1 and cover the area 2πσ² G(A):

    G(A) = 1 + ln A   (Kerbl 2024),      G(A) = 1 + 1/2 + … + 1/A   (Spark; between whole numbers the digamma function).

A logit cannot hold an opacity above 1. Such a Gaussian is read as the one with the same peak and the same area: opacity
`MERGED_ALPHA_MAX`, and all axes longer by √G. Between peak and rim the footprints differ: a Gaussian falls off from its
centre, the plateau stays opaque farther out.
"""

import numpy as np

from splatree.constants import MERGED_ALPHA_MAX
from splatree.shapes import Array, Float32

__all__ = ["CODE_STEP", "areas_of_clamped", "areas_of_powers", "logits_from_opacities", "opacities_from_logits"]


CODE_STEP = 2e-6
"""Step for 8-bit codes: 0 and 255 stand for opacities nearer to 0 and 1 than the other codes say, as in our other formats."""


def opacities_from_logits(logits: Array) -> Float32[Array, "n"]:
    """Opacities 0 to 1."""
    return np.asarray(np.exp(-np.logaddexp(0, -logits.astype(np.float64))), np.float32)


def logits_from_opacities(opacities: Array, *, step_low: float, step_high: float) -> Float32[Array, "n"]:
    """Logits of opacities; those above 1 give that of `MERGED_ALPHA_MAX`.

    0 and 1 have no logit: they are taken for half a step of the file's numbers, ``step_low`` at 0 and ``step_high`` at 1,
    from there. NaN and negative values stay what no check lets pass.
    """
    a = opacities.astype(np.float64)
    a = np.where(a > 1, MERGED_ALPHA_MAX, np.clip(a, step_low / 2, 1 - step_high / 2))
    a[~(opacities >= 0)] = np.nan
    return np.asarray(np.log(a) - np.log1p(-a), np.float32)


def areas_of_clamped(opacities: Array) -> Array:
    """G of opacities above 1, 1 of others, where the footprint is min(1, A e^(−r²/2σ²))."""
    return np.asarray(1 + np.log(np.fmax(opacities.astype(np.float64), 1)))


def areas_of_powers(exponents: Array) -> Array:
    """G of exponents above 1, 1 of others, where the footprint is 1 − (1 − e^(−r²/2σ²))^A: the harmonic number H_A."""
    a = np.fmax(exponents.astype(np.float64), 1)
    # H_A = H_(A+3) − 1/(A+1) − 1/(A+2) − 1/(A+3), and from x = 4 on H_x is this series within 1e-6.
    x = a + 3.5
    series = np.log(x) + np.euler_gamma + 1 / (24 * x**2) - 7 / (960 * x**4)
    return np.asarray(series - 1 / (a + 1) - 1 / (a + 2) - 1 / (a + 3))
