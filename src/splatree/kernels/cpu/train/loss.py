"""The loss of a picture against a photograph: glue over loss.cpp; kernels/reference/loss.py is the definition."""

import numpy as np

from splatree.constants import SSIM_K1, SSIM_K2
from splatree.kernels.cpu import _core
from splatree.kernels.reference.loss import TAPS
from splatree.scene.gradients import PhotoLoss
from splatree.shapes import Array, Bool, Float32, Float64, UInt8

__all__ = ["photo_loss"]


def photo_loss(
    image: Float32[Array, "h w 3"],
    photo: UInt8[Array, "h w 3"],
    gain: Float64[Array, "3"],
    *,
    ssim_weight: float = 0.2,
    mask: Bool[Array, "h w"] | None = None,
    threads: int = 0,
) -> PhotoLoss:
    """The loss and its derivative."""
    size = 3.0 * max(1, int(mask.sum()) if mask is not None else image.shape[0] * image.shape[1])
    by_image, errors = np.empty(image.shape, np.float32), np.empty(image.shape[:2], np.float32)
    counted = None if mask is None else np.ascontiguousarray(mask).view(np.uint8)
    difference, index, *sums = _core.compare_photo(
        *(image, np.ascontiguousarray(photo), counted, gain.tolist(), TAPS.tolist()),
        *([SSIM_K1**2, SSIM_K2**2], [(1 - ssim_weight) / size, ssim_weight / size], by_image, errors, threads),
    )
    value = ((1 - ssim_weight) * difference + ssim_weight * (size - index)) / size
    return PhotoLoss(value, by_image, errors, np.array(sums[:3]), np.array(sums[3:]))
