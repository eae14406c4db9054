"""Peak signal-to-noise ratio: ``10 log10(peak² / mean((a − b)²))`` over all pixels and channels, dB."""

import numpy as np

from splatree.errors import InputError
from splatree.scene.arguments import checked
from splatree.shapes import Array, Float32

PEAK_MAX = 1e9
"""White of pictures of any kind is less; the squares of what is larger would be infinite."""


@checked
def psnr(image: Float32[Array, "h w 3"], reference: Float32[Array, "h w 3"], *, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio of two pictures.

    Values are compared as they are: clip first what will be shown clipped.

    Args:
        image: a picture, (h w 3).
        reference: the picture to compare it with, of the same shape.
        peak: largest value that a channel can have.

    Returns:
        10 log₁₀(peak² / mean squared error), dB; infinity if the pictures are equal.

    Raises:
        InputError: the pictures differ in shape, hold no pixel, NaN or infinity, or whole numbers with a peak of 1.

    Example:
        >>> black = np.zeros((8, 8, 3))
        >>> round(st.psnr(black + 0.1, black), 3)
        20.0
    """
    a, b = comparable(image, reference, peak)
    error = float(np.mean((a - b) ** 2))
    return float("inf") if error == 0 else float(10 * np.log10(peak * peak / error))


def comparable(image: Array, reference: Array, peak: float = 1.0) -> tuple[Array, Array]:
    """Both pictures in float64.

    Raises:
        InputError: they differ in shape, are empty, hold NaN or infinity, or are whole numbers whose largest is said to be 1;
            or ``peak`` is no largest value of pictures.
    """
    if not 0 < peak <= PEAK_MAX:
        raise InputError(f"peak: found {peak}, wanted more than 0, at most {PEAK_MAX:,}: the value of white")
    for picture in (image, reference):
        if peak == 1 and (dtype := np.asarray(picture).dtype).kind in "iu":
            raise InputError(f"pictures to compare: found {dtype.name}, wanted floats from 0 to 1; divide bytes by 255")
    a, b = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if a.shape != b.shape:
        raise InputError(f"pictures to compare: found shapes {a.shape} and {b.shape}, wanted equal ones; resize one")
    if a.size == 0:
        raise InputError(f"pictures to compare: found shape {a.shape}, wanted at least one pixel")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("pictures to compare: found NaN or infinity, wanted finite values")
    return a, b
