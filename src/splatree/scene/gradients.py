"""Derivatives of a loss, as the backward stages take and leave them (kernels/contract.py)."""

from dataclasses import dataclass

import numpy as np

from splatree.shapes import Array, Float32, Float64, Int32, UInt16, check_fields

__all__ = ["GaussianGradients", "Moments", "PhotoLoss", "PictureGradients", "SplatGradients"]


@dataclass(frozen=True, eq=False)
class PictureGradients:
    """Derivatives of a loss by the values of a picture."""

    image: Float32[Array, "h w 3"]
    """By the colour over the background."""
    alpha: Float32[Array, "h w"] | None = None
    """By the share of light that the splats stop; None: the loss does not depend on it."""
    depth: Float32[Array, "h w"] | None = None
    """By the blended depth, per world unit; None: the loss does not depend on it."""
    errors: Float32[Array, "h w"] | None = None
    """No derivative: how wrong each pixel is, for `SplatGradients.errors`; None: not asked for."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class SplatGradients:
    """Sums over the pixels of each splat, from which the derivatives by its parameters follow.

    L is the triangular factor of a splat, (u, v) = √(½ log₂ e) L (pixel − centre) the offset in its own units, and h = α ∂loss/∂α
    at a pixel, 0 where α is held at 0.99. The derivatives by centre, factor and opacity combine the moments of h. Unlike
    sums in the coordinates of the picture, moments in units of the splat do not cancel for long thin splats.
    """

    moments: Float32[Array, "v 6"]
    """Σ h · (1, u, v, u², u v, v²) over the pixels that blended the splat."""
    colors: Float32[Array, "v 3"]
    """Derivative by the splat's colour: Σ T α ∂loss/∂image."""
    depths: Float32[Array, "v"] | None = None
    """Derivative by the splat's depth, per world unit; None: the loss does not depend on depths."""
    weights: Float32[Array, "v"] | None = None
    """No derivative: Σ T α, the pixels that the splat covers, px; None unless errors were asked for."""
    errors: Float32[Array, "v"] | None = None
    """No derivative: Σ T α times the error of the pixel; None unless errors were asked for."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class GaussianGradients:
    """Derivatives of a loss by the columns of the Gaussians that were drawn, in their encodings."""

    rows: Int32[Array, "v"]
    """Row of the scene of each entry: those of the splats; all other rows have derivatives of 0."""
    means: Float32[Array, "v 3"]
    """By the centres, per world unit."""
    quats: Float32[Array, "v 4"]
    """By the quaternions as they are stored, of any length."""
    log_scales: Float32[Array, "v 3"]
    """By the logarithms of the standard deviations."""
    logit_opacities: Float32[Array, "v"]
    """By the opacities before the sigmoid."""
    sh: Float32[Array, "v k 3"]
    """By the harmonics."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class PhotoLoss:
    """How far a picture is from a photograph, and the derivatives."""

    value: float
    """(1 − λ) mean |g X − Y| + λ (1 − mean SSIM), of a picture X, a gain g for each channel and a photograph Y."""
    image: Float32[Array, "h w 3"]
    """Derivative by the picture."""
    errors: Float32[Array, "h w"]
    """Mean of |g X − Y| over the channels, of each pixel; 0 where masked."""
    products: Float64[Array, "3"]
    """Σ X Y of each channel, over the pixels that are not masked."""
    squares: Float64[Array, "3"]
    """Σ X² of each channel: products / squares is the gain that fits best."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Moments:
    """What the optimiser remembers of each row; arrays change in place.

    A row's moments lie side by side in the order means, quats, log_scales, logit_opacities, sh, with zeros after them up to a
    multiple of 8.
    """

    values: Float32[Array, "n 2 e"]
    """Running means of the derivatives, and of their squares."""
    steps: UInt16[Array, "n"]
    """Steps that each row has made, at most 65,535."""

    def __post_init__(self) -> None:
        check_fields(self)

    @staticmethod
    def zeros(num_rows: int, num_coefficients: int) -> "Moments":
        """Those of rows that have made no step, with ``num_coefficients`` harmonics a channel."""
        width = 11 + 3 * num_coefficients
        return Moments(np.zeros((num_rows, 2, -(-width // 8) * 8), np.float32), np.zeros(num_rows, np.uint16))
