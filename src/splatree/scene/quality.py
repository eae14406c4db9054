"""How good a cut of some levels looks: the PSNR against all leaves, predicted from a sketch of the cut (lod/sketch.py).

Only merged nodes differ from the leaves. A sketch says which share of the picture they are, *merged*, and how much the colours of
their leaves vary there, *varied*. The curve is fitted to pictures of made views (render/quality.py):

    PSNR = offset + by_pixel_error ln τ_R + by_fine min(0, ln(τ_R / fine))
                  + by_merged · 10 log₁₀ merged + by_varied · 10 log₁₀ varied

Small nodes are about a pixel, whose own blur hides what they leave out: the third term.
"""

import math
from dataclasses import dataclass, fields

from splatree.errors import InputError

__all__ = ["LEAST_SHARE", "QualityCurve"]

LEAST_SHARE = 1e-9
"""Smaller numbers are taken for it: a logarithm is taken of them."""


@dataclass(frozen=True)
class QualityCurve:
    """PSNR of cuts against all leaves, by the pixel error and by what is in view.

    Example:
        >>> curve = st.QualityCurve(25.0, -2.0, 0.0, 2.0, -0.5, -0.7, error_db=0.8, num_pictures=40)
        >>> round(curve.psnr(3, merged=1, varied=0.01), 2)
        36.8
    """

    offset: float
    """dB at τ_R = 1 px in a view that is all merged, of leaves whose colours vary by 1."""
    by_pixel_error: float
    """dB for each unit of ln τ_R; not above 0."""
    by_fine: float
    """dB more for each unit of ln τ_R below fine_px; not above 0."""
    fine_px: float
    """τ_R below which nodes are small, px."""
    by_merged: float
    """dB for each dB of the share of the picture that merged nodes are; with by_varied not above 0."""
    by_varied: float
    """dB for each dB of the variance of colours within merged nodes; not above 0."""
    error_db: float
    """Root mean square error of the fit, dB."""
    num_pictures: int
    """Pictures of cuts that the curve was fitted to."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, int | float) or not abs(value) < 1e6 or isinstance(value, bool):
                raise InputError(f"QualityCurve.{field.name}: found {value!r}, wanted a finite number")
        rises = max(self.by_pixel_error, self.by_fine, self.by_varied, self.by_merged + self.by_varied) > 0
        if rises or self.error_db < 0 or self.fine_px <= 0:
            raise InputError(f"QualityCurve: found {self}, wanted a PSNR that does not rise with what is merged")

    def psnr(self, pixel_error: float, *, merged: float, varied: float) -> float:
        """Predicted PSNR against all leaves, dB; infinity if nothing is merged."""
        if merged <= 0 or pixel_error <= 0:
            return math.inf
        by_merged, by_varied = (10 * math.log10(max(share, LEAST_SHARE)) for share in (merged, varied))
        shown = self.by_merged * by_merged + self.by_varied * by_varied
        below = min(0.0, math.log(pixel_error / self.fine_px))
        by_size = self.by_pixel_error * math.log(pixel_error) + self.by_fine * below
        return self.offset + by_size + shown
