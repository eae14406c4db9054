"""A picture beside a photograph of another exposure: PSNR after a gain for each channel.

Photographs of one scene differ in brightness, which says nothing about the scene. The gain that fits best, Σ X Y / Σ X², is
found on the left half of the picture. The score is taken on the right half alone, so that no pixel is scored by its own fit.
"""

import numpy as np

from splatree.metrics.psnr import comparable, psnr
from splatree.shapes import Array, Bool, Float32, Float64

__all__ = ["fitted_gain", "psnr_with_gain"]


def fitted_gain(image: Float32[Array, "h w 3"], photo: Float32[Array, "h w 3"]) -> Float64[Array, "3"]:
    """The factor of each channel that brings a picture nearest to a photograph; 1 where the picture is black."""
    X, Y = (np.asarray(picture, np.float64).reshape(-1, 3) for picture in (image, photo))
    squares = np.sum(X * X, axis=0)
    return np.asarray(np.divide(np.sum(X * Y, axis=0), squares, out=np.ones(3), where=squares > 0))


def psnr_with_gain(
    image: Float32[Array, "h w 3"], photo: Float32[Array, "h w 3"], mask: Bool[Array, "h w"] | None = None
) -> float | None:
    """PSNR of the right half, dB, after the gain that fits the left half best; None if a half has no pixel that counts.

    Args:
        image: a picture, not clipped; clipped to 0 to 1 after the gain.
        photo: the photograph, 0 to 1.
        mask: pixels that count; None: all.

    Raises:
        ShapeError: the pictures differ in shape.
    """
    comparable(image, photo)
    middle = image.shape[1] // 2
    counts = np.ones(image.shape[:2], bool) if mask is None else mask
    left, right = counts[:, :middle], counts[:, middle:]
    if not (left.any() and right.any()):
        return None
    gain = fitted_gain(image[:, :middle][left], photo[:, :middle][left])
    return psnr(np.clip(image[:, middle:][right] * gain, 0, 1).astype(np.float32)[None], photo[:, middle:][right][None])
