"""The loss of a picture against a photograph on a device (loss.cu); kernels/reference/loss.py is the definition."""

import numpy as np

from splatree.constants import SSIM_K1, SSIM_K2, TILE_PX
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.job import pack_fields
from splatree.kernels.reference.loss import TAPS
from splatree.scene.gradients import PhotoLoss
from splatree.shapes import Array, Bool, Float32, Float64, UInt8

__all__ = ["photo_loss"]

NUM_SUMS = 8
"""Of a thread block: |g X − Y|, the index, X Y and X² of each channel (LossSum in shared/sums.h)."""


def photo_loss(
    device: Device,
    image: Float32[Array, "h w 3"],
    photo: UInt8[Array, "h w 3"],
    gain: Float64[Array, "3"],
    ssim_weight: float,
    mask: Bool[Array, "h w"] | None,
) -> PhotoLoss:
    """The loss and its derivative."""
    height, width = image.shape[:2]
    counts = np.ones((height, width), np.uint8) if mask is None else mask.astype(np.uint8)
    size = 3.0 * max(1, int(counts.sum()))
    numbers = [*TAPS, *gain, SSIM_K1**2, SSIM_K2**2, (1 - ssim_weight) / size, ssim_weight / size]
    num_blocks = -(-width // TILE_PX) * -(-height // TILE_PX)
    arrays = {
        "image": device.upload(image, name="image"),
        "photo": device.upload(photo, name="photo"),
        "mask": device.upload(counts, name="mask"),
        "numbers": device.upload(np.array(numbers, np.float32), name="numbers"),
        "maps": device.empty((3, height, width, 3), np.float32, name="maps"),
        "by_image": device.empty((height, width, 3), np.float32, name="by_image"),
        "errors": device.empty((height, width), np.float32, name="errors"),
        "sums": device.empty((num_blocks, NUM_SUMS), np.float32, name="sums"),
    }
    pointers = {name: array.pointer for name, array in arrays.items()}
    job = device.upload(pack_fields("cuda/loss.h", "LossJob", pointers, {"width": width, "height": height}))
    for kernel in ("compare_photo", "slope_of_loss"):
        device.launch(kernel, num_blocks, job)
    difference, index, *sums = arrays["sums"].numpy().sum(axis=0, dtype=np.float64)
    value = ((1 - ssim_weight) * difference + ssim_weight * (size - index)) / size
    by_image, errors = arrays["by_image"].numpy(), arrays["errors"].numpy()
    return PhotoLoss(float(value), by_image, errors, np.array(sums[:3]), np.array(sums[3:]))
