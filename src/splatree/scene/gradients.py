"""Derivatives of a loss, as the backward stages take and leave them (kernels/contract.py)."""

from dataclasses import dataclass

from splatree.shapes import Array, Float32, Int32, check_fields

__all__ = ["GaussianGradients", "PictureGradients", "SplatGradients"]


@dataclass(frozen=True, eq=False)
class PictureGradients:
    """Derivatives of a loss by the values of a picture."""

    image: Float32[Array, "h w 3"]
    """By the colour over the background."""
    alpha: Float32[Array, "h w"] | None = None
    """By the share of light that the splats stop; None: the loss does not depend on it."""
    depth: Float32[Array, "h w"] | None = None
    """By the blended depth, per world unit; None: the loss does not depend on it."""

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
