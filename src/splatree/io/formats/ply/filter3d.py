"""The 3D filter of Mip-Splatting and of Gaussian Opacity Fields, fused into scales and opacities.

Their files hold the standard deviation f of a filter beside each Gaussian, ``filter_3D``, and draw (Yu 2024, Mip-Splatting,
Eq. 7; in the code ``get_scaling_with_3D_filter`` and ``get_opacity_with_3D_filter``)

    s' = √(s² + f²)  along each axis,      o' = o √(Π s² / Π s'²)

A program that leaves ``filter_3D`` out draws sharper and more opaque Gaussians than were trained. Fused, the file is an ordinary
one, as their ``save_fused_ply`` writes it.
"""

import numpy as np

from splatree.shapes import Array, Float32

__all__ = ["fuse_filter"]


@np.errstate(all="ignore")  # whatever comes of absurd values is found by the check of values
def fuse_filter(
    log_scales: Float32[Array, "n a"], logit_opacities: Float32[Array, "n"], filters: Float32[Array, "n"]
) -> tuple[Float32[Array, "n a"], Float32[Array, "n"]]:
    """Scales and opacities of the filtered Gaussians; rows whose filter is 0 keep their bits."""
    s = log_scales.astype(np.float64)
    # log s' = log s + ½ log(1 + f² / s²), so that neither squares nor their product can overflow.
    wider = 0.5 * np.log1p(np.exp(2 * (np.log(np.abs(filters.astype(np.float64)))[:, None] - s)))
    log_share = -wider.sum(axis=1)
    # o' = c σ(x) with log c = log_share: logit(o') = log o' − log(1 − o').
    log_opacity = log_share - np.logaddexp(0, -logit_opacities.astype(np.float64))
    logits = log_opacity - np.log(-np.expm1(log_opacity))
    kept = filters == 0
    return (
        np.where(kept[:, None], log_scales, s + wider).astype(np.float32),
        np.where(kept, logit_opacities, logits).astype(np.float32),
    )
