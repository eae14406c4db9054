"""How good a cut of some levels looks: the PSNR against all leaves, predicted from what is known before anything is drawn.

Two numbers of a view stand beside the pixel error τ_R (lod/quality.py). *merged* is the share of what is drawn that merged nodes
stand for: near by few nodes are merged, and these alone can differ from the leaves. *covered* is the share of the picture in
which something is drawn: the rest is equal in both pictures. The curve is fitted to pictures of made views (render/quality.py):

    PSNR = offset + by_pixel_error ln τ_R + by_merged · 10 log₁₀ merged + by_covered · 10 log₁₀ covered
"""

import math
from dataclasses import dataclass, fields

from splatree.errors import InputError

__all__ = ["LEAST_SHARE", "QualityCurve"]

LEAST_SHARE = 1e-6
"""Shares below this are taken for it: a logarithm is taken of them."""


@dataclass(frozen=True)
class QualityCurve:
    """PSNR of cuts against all leaves, by the pixel error and by what is in view.

    Example:
        >>> curve = st.QualityCurve(45.0, -8.0, -1.2, -1.0, error_db=0.8, num_pictures=40)
        >>> round(curve.psnr(3, merged=1, covered=1), 2)
        36.21
    """

    offset: float
    """dB at τ_R = 1 px in a view that is covered and all merged."""
    by_pixel_error: float
    """dB for each unit of ln τ_R; not above 0."""
    by_merged: float
    """dB for each dB of the share that is merged; not above 0."""
    by_covered: float
    """dB for each dB of the share of the picture that is covered."""
    error_db: float
    """Root mean square error of the fit, dB."""
    num_pictures: int
    """Pictures of cuts that the curve was fitted to."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, int | float) or not abs(value) < 1e6 or isinstance(value, bool):
                raise InputError(f"QualityCurve.{field.name}: found {value!r}, wanted a finite number")
        if self.by_pixel_error > 0 or self.by_merged > 0 or self.error_db < 0:
            raise InputError(f"QualityCurve: found {self}, wanted a PSNR that does not rise with the pixel error")

    def psnr(self, pixel_error: float, *, merged: float, covered: float) -> float:
        """Predicted PSNR against all leaves, dB; infinity if nothing is merged."""
        if merged <= 0 or pixel_error <= 0:
            return math.inf
        shares = (10 * math.log10(max(share, LEAST_SHARE)) for share in (merged, covered))
        by_share = sum(by * share for by, share in zip((self.by_merged, self.by_covered), shares, strict=True))
        return self.offset + self.by_pixel_error * math.log(pixel_error) + by_share
