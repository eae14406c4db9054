"""The loss of a picture against a photograph, and its derivative: the definition.

    loss = (1 − λ) mean |g X − Y| + λ (1 − mean SSIM(g X, Y))                             (Kerbl 2023, Eq. 7; λ = 0.2)

for the picture X, a gain g for each channel and the photograph Y. SSIM is Wang 2004, Eq. 13 with zeros beyond the borders
(metrics/ssim.py, `zero`). With the blurs μ_x, μ_y, e_xx, e_yy, e_xy of X, Y, X², Y², X Y and

    A₁ = 2 μ_x μ_y + C₁,  A₂ = 2 (e_xy − μ_x μ_y) + C₂,  B₁ = μ_x² + μ_y² + C₁,  B₂ = e_xx − μ_x² + e_yy − μ_y² + C₂
    S = A₁ A₂ / (B₁ B₂)

    P = ∂S/∂μ_x = 2 μ_y (A₂ − A₁) / (B₁ B₂) − 2 μ_x S / B₁ + 2 μ_x S / B₂
    Q = ∂S/∂e_xx = −S / B₂
    R = ∂S/∂e_xy = 2 A₁ / (B₁ B₂)

the derivative is ∂ΣS/∂X = G∗P + 2 X (G∗Q) + Y (G∗R), three more blurs. A masked pixel counts as if the picture were right there:
it takes no derivative, adds no error, and means are over the pixels that are not masked.
"""

import numpy as np

from splatree.constants import SSIM_K1, SSIM_K2, SSIM_SIGMA_PX, SSIM_WINDOW_PX
from splatree.scene.gradients import PhotoLoss
from splatree.shapes import Array, Bool, Float32, Float64, UInt8

__all__ = ["TAPS", "photo_loss"]

TAPS = np.exp(-((np.arange(SSIM_WINDOW_PX) - SSIM_WINDOW_PX // 2) ** 2) / (2 * SSIM_SIGMA_PX**2))
TAPS /= TAPS.sum()
"""The window along one axis."""


def photo_loss(
    image: Float32[Array, "h w 3"],
    photo: UInt8[Array, "h w 3"],
    gain: Float64[Array, "3"],
    *,
    ssim_weight: float = 0.2,
    mask: Bool[Array, "h w"] | None = None,
    threads: int = 0,
) -> PhotoLoss:
    """The loss and its derivative.

    Args:
        image: the picture X, linear, not clipped.
        photo: the photograph Y, 0 to 255.
        gain: of each channel.
        ssim_weight: λ, 0 to 1.
        mask: pixels that count; None: all.
        threads: not used.
    """
    counts = np.ones(image.shape[:2], bool) if mask is None else mask
    X, Y = image.astype(np.float64), photo / 255.0
    size = 3.0 * max(1, int(counts.sum()))
    seen = np.where(counts[..., None], X * gain, Y)
    index, by_seen = _ssim(seen, Y, counts)
    difference = seen - Y
    value = (1 - ssim_weight) * np.abs(difference).sum() / size + ssim_weight * (1 - index / size)
    by_seen = ((1 - ssim_weight) * np.sign(difference) - ssim_weight * by_seen) / size
    derivative = np.where(counts[..., None], by_seen * gain, 0.0)
    inside = X[counts]
    return PhotoLoss(
        float(value),
        derivative.astype(np.float32),
        np.abs(difference).mean(axis=2).astype(np.float32),
        np.sum(inside * Y[counts], axis=0),
        np.sum(inside * inside, axis=0),
    )


def _ssim(X: Array, Y: Array, counts: Array) -> tuple[float, Array]:
    """Sum of the index over the pixels that count and the channels, and its derivative by X."""
    c1, c2 = SSIM_K1**2, SSIM_K2**2
    mx, my, xx, yy, xy = (_blurred(plane) for plane in (X, Y, X * X, Y * Y, X * Y))
    a1, a2 = 2 * mx * my + c1, 2 * (xy - mx * my) + c2
    b1, b2 = mx * mx + my * my + c1, xx - mx * mx + yy - my * my + c2
    S = a1 * a2 / (b1 * b2)
    P = 2 * my * (a2 - a1) / (b1 * b2) - 2 * mx * S / b1 + 2 * mx * S / b2
    Q, R = -S / b2, 2 * a1 / (b1 * b2)
    weighed = [_blurred(plane * counts[..., None]) for plane in (P, Q, R)]
    return float((S * counts[..., None]).sum()), weighed[0] + 2 * X * weighed[1] + Y * weighed[2]


def _blurred(plane: Array) -> Array:
    half = SSIM_WINDOW_PX // 2
    for axis in (0, 1):
        padded = np.pad(plane, [(half, half) if i == axis else (0, 0) for i in range(3)])
        plane = sum(tap * np.take(padded, np.arange(plane.shape[axis]) + i, axis) for i, tap in enumerate(TAPS))
    return plane
