"""Structural similarity of two pictures (Wang 2004).

With local means μ, variances σ² and covariance σ_ab under a Gaussian window of 11 × 11 px, σ = 1.5 px (Wang 2004, Eq. 13)::

    SSIM = (2 μ_a μ_b + C1) (2 σ_ab + C2) / ((μ_a² + μ_b² + C1) (σ_a² + σ_b² + C2)),  C1 = (0.01 peak)², C2 = (0.03 peak)²

averaged over the places where the window lies inside the picture, and over the channels. The code of Kerbl 2023 computes the
same index, but pads the pictures with zeros and averages over every pixel, so a black frame of 5 px takes part: equal there,
the frame makes its values a little higher or lower. ``border="zero"`` does as that code does.

The window is separable: 2 × 11 taps for each of four maps (μ_a, μ_b, the sum of both squares, the product).
"""

from typing import Literal, get_args

import numpy as np

from splatree.constants import SSIM_K1, SSIM_K2, SSIM_SIGMA_PX, SSIM_WINDOW_PX
from splatree.errors import InputError
from splatree.metrics.psnr import comparable
from splatree.scene.arguments import checked
from splatree.shapes import Array, Float32, Float64

Border = Literal["valid", "zero"]
"""Where the window is evaluated: inside the picture only, or everywhere with zeros beyond the edge."""


@checked
def ssim(
    image: Float32[Array, "h w 3"], reference: Float32[Array, "h w 3"], *, peak: float = 1.0, border: Border = "valid"
) -> float:
    """Mean structural similarity of two pictures, computed for each channel in float64.

    Args:
        image: a picture, (h w 3).
        reference: the picture to compare it with, of the same shape.
        peak: largest value that a channel can have.
        border: `valid` places the window inside the picture only; `zero` places it everywhere, with zeros beyond the edge.

    Returns:
        The mean over pixels and channels, at most 1.

    Raises:
        InputError: the pictures differ in shape, or are smaller than the window.

    Source:
        Wang 2004, "Image Quality Assessment: From Error Visibility to Structural Similarity", Eq. 13.

    Example:
        >>> image = np.random.default_rng(0).random((16, 16, 3), np.float32)
        >>> st.ssim(image, image)
        1.0
    """
    a, b = comparable(image, reference, peak)
    if border not in get_args(Border):
        raise InputError(f"ssim: found border {border!r}, wanted one of {', '.join(get_args(Border))}")
    if min(a.shape[:2]) < SSIM_WINDOW_PX and border == "valid":
        raise InputError(
            f"ssim: found a picture of {a.shape[1]} × {a.shape[0]} px, wanted at least {SSIM_WINDOW_PX} × {SSIM_WINDOW_PX}"
        )
    a, b = (np.atleast_3d(x) for x in (a, b))
    return float(np.mean([_ssim_of_channel(a[..., c], b[..., c], peak, border) for c in range(a.shape[2])]))


def _ssim_of_channel(a: Float64[Array, "h w"], b: Float64[Array, "h w"], peak: float, border: Border) -> float:
    c1, c2 = (SSIM_K1 * peak) ** 2, (SSIM_K2 * peak) ** 2
    mean_a, mean_b = _blurred(a, border), _blurred(b, border)
    product, squares = mean_a * mean_b, mean_a**2 + mean_b**2
    covariance = _blurred(a * b, border) - product
    variances = _blurred(a * a + b * b, border) - squares
    index = (2 * product + c1) * (2 * covariance + c2) / ((squares + c1) * (variances + c2))
    return float(index.mean())


def _blurred(plane: Float64[Array, "h w"], border: Border) -> Array:
    if border == "zero":
        plane = np.pad(plane, SSIM_WINDOW_PX // 2)
    taps = np.exp(-((np.arange(SSIM_WINDOW_PX) - SSIM_WINDOW_PX // 2) ** 2) / (2 * SSIM_SIGMA_PX**2))
    taps /= taps.sum()
    for axis in (0, 1):
        size = plane.shape[axis] - SSIM_WINDOW_PX + 1
        lines = plane if axis == 0 else plane.T
        total = taps[0] * lines[:size]
        for i in range(1, SSIM_WINDOW_PX):
            total += taps[i] * lines[i : i + size]
        plane = total if axis == 0 else total.T
    return plane
