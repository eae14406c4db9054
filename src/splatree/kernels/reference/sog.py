"""The pixels of SOG version 2: what the fast kernels must give, up to values that lie between two codes."""

import numpy as np

from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int32, UInt8


def encode(
    gaussians: Gaussians,
    order: Int32[Array, "n"],
    mean_ranges: Float64[Array, "2 3"],
    scale_bounds: Float32[Array, "255"],
    dc_bounds: Float32[Array, "255"],
    *,
    threads: int = 0,
) -> dict[str, UInt8[Array, "n c"]]:
    """Codes of each picture, in the given order of rows; a code of a codebook is the number of bounds below the value."""
    g = gaussians.take(order)
    x = g.means.astype(np.float64)
    low, high = mean_ranges
    spread = np.where(high > low, high - low, 1.0)
    u = np.clip(np.rint((np.sign(x) * np.log1p(np.abs(x)) - low) / spread * 65535), 0, 65535).astype(np.uint16)

    quats = g.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    largest = np.abs(quats).argmax(axis=1)
    quats *= np.where(np.take_along_axis(quats, largest[:, None], axis=1) < 0, -1.0, 1.0)  # q and −q are one rotation
    others = quats[np.arange(4) != largest[:, None]].reshape(-1, 3)
    tags = (252 + largest)[:, None]

    opacities = 1 / (1 + np.exp(-g.logit_opacities.astype(np.float64)))
    return {
        "means_l": (u & 255).astype(np.uint8),
        "means_u": (u >> 8).astype(np.uint8),
        "quats": np.hstack([np.clip(np.rint((others * np.sqrt(0.5) + 0.5) * 255), 0, 255), tags]).astype(np.uint8),
        "scales": np.searchsorted(scale_bounds, g.log_scales).astype(np.uint8),
        "sh0": np.hstack([np.searchsorted(dc_bounds, g.sh[:, 0]), np.rint(opacities * 255)[:, None]]).astype(np.uint8),
    }
