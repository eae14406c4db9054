"""Peak signal-to-noise ratio: ``10 log10(peak² / mean((a − b)²))`` over all pixels and channels, dB."""

import numpy as np

from splatree.errors import InputError
from splatree.shapes import Array, Float32


def psnr(image: Float32[Array, "h w 3"], reference: Float32[Array, "h w 3"], *, peak: float = 1.0) -> float:
    """Return the peak signal-to-noise ratio in dB; infinity for equal pictures.

    ``peak`` is the largest value that a channel can have. Values above it are compared as they are: clip first what
    will be shown clipped.
    """
    a, b = comparable(image, reference)
    error = float(np.mean((a - b) ** 2))
    return float("inf") if error == 0 else float(10 * np.log10(peak * peak / error))


def comparable(image: Array, reference: Array) -> tuple[Array, Array]:
    """Both pictures in float64.

    Raises:
        InputError: they differ in shape, are empty, or hold NaN or infinity.
    """
    a, b = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if a.shape != b.shape:
        raise InputError(f"pictures to compare: found shapes {a.shape} and {b.shape}, wanted equal ones; resize one")
    if a.size == 0:
        raise InputError(f"pictures to compare: found shape {a.shape}, wanted at least one pixel")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("pictures to compare: found NaN or infinity, wanted finite values")
    return a, b
