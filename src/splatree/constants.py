"""Every number of standard 3D Gaussian Splatting, each with its unit and source.

Kerbl 2023 is "3D Gaussian Splatting for Real-Time Radiance Field Rendering" and its public code.
"""

import math
from typing import Final

ALPHA_THRESHOLD: Final = 1.0 / 255.0
"""Smallest opacity that is blended: below it 8-bit colour cannot change (Kerbl 2023, rasterizer)."""

LOG2_ALPHA_THRESHOLD: Final = math.log2(ALPHA_THRESHOLD)
"""The same as a power of two: the kernels compare opacities by their logarithms."""

ALPHA_MAX: Final = 0.99
"""Largest opacity of one splat at one pixel (Kerbl 2023, rasterizer)."""

TRANSMITTANCE_MIN: Final = 1e-4
"""A pixel is finished once less than this share of light passes (Kerbl 2023, rasterizer)."""

DILATION_PX2: Final = 0.3
"""Variance added to both axes of a projected splat, px² (Kerbl 2023: about one pixel wide at least)."""

SSIM_WINDOW_PX: Final = 11
"""Edge of the window of the structural similarity, px (Wang 2004, §III-B)."""

SSIM_SIGMA_PX: Final = 1.5
"""Standard deviation of that window, px (Wang 2004, §III-B)."""

SSIM_K1: Final = 0.01
"""Keeps the quotient of means steady where they vanish, for pictures of 0 to 1 (Wang 2004, §III-B)."""

SSIM_K2: Final = 0.03
"""The same for variances."""

NEAR: Final = 0.2
"""Gaussians whose centre is nearer than this, in world units along the view axis, are not drawn (Kerbl 2023)."""

TILE_PX: Final = 16
"""Edge of a screen tile, px (Kerbl 2023)."""

FRUSTUM_CLAMP: Final = 1.3
"""View directions are clamped to this multiple of the half field of view in the projection's Jacobian (Kerbl 2023)."""

DILATION_MIN_PX2: Final = 1e-6
"""Variance that a splat has at least, px²: without any dilation a needle seen end on would have no inverse."""

SIGMA_MAX_PX: Final = 5e8
"""Standard deviations are drawn as at most this, px, so that the float32 determinant (σ⁴) stays finite: far beyond any
picture, where the splat is flat to the last bit."""

SIGMAS: Final = 3.0
"""Standard deviations that bound a Gaussian where opacity is not considered (Kerbl 2023)."""

TAPER_SLOPE: Final = 2.0
"""Slope of a tapered opacity above the splat's floor: twice the floor is where the splat is drawn as it is."""

SHRINK_AREA_POWER: Final = 0.4
"""By the tile rule `balanced` τ falls with this power of a splat's area √det Σ': between ½, at which a lost tile costs all splats
the same squared error while they are smaller than a tile, and less for those that are larger."""

SHRINK_AREA_PX2: Final = 0.3
"""Area √det Σ', px², at which the tile rule `balanced` has τ itself: the smallest that there is with the usual dilation."""

LOG2_SHRINK_AREA_PX2: Final = math.log2(SHRINK_AREA_PX2)
"""The same as a power of two."""

SHRINK_ENERGY_MIN: Final = 0.01
"""Floor of ln(α/τ) by the tile rule `tau`; never in force beside SHRINK_RATIO_MIN (code of FilterGS)."""

SHRINK_RATIO_MIN: Final = 0.1
"""The squares of `tau` are at least this share of 3 σ (code of FilterGS, for rendering)."""

SHRINK_PAD_PX: Final = 1.0
"""Added to the radius of a square of `tau`, px (code of FilterGS)."""

PIXEL_ERROR: Final = 3.0
"""Default τ_R: a node whose projected radius is at most this, px, stands for its subtree (FilterGS §3.2)."""

DILATION_MAX_PX2: Final = 1e12
"""Largest dilation, px²: a standard deviation of 10⁶ px, the largest side of a picture; its square is within float32's range."""

EIGENVALUE_FLOOR_PX4: Final = 0.1
"""Floor, px⁴, under the root in the larger eigenvalue of a splat's covariance (Kerbl 2023, rasterizer)."""

CENTRE_PAD: Final = 0.1
"""Share of the half image by which a centre may lie outside in the view test `centre` (code of FilterGS)."""

BLOCK_ROWS: Final = 256
"""Rows of a block of the selection: its bounds and ancestors take about 0.7 bytes a row."""

BLOCK_STEPS: Final = 8
"""Steps, by extent, of the largest standard deviation of rows that are drawn in a block: without them near views of levels by
pairs look at twice as many blocks."""

BLOCKS_PER_GROUP: Final = 64
"""Blocks of a group, the unit that the selection hands to a thread: 16,384 rows, a tenth of a millisecond at most."""

SH_C0: Final = 0.28209479177387814
"""Y_00 = 1 / (2 √π)."""

SH_C1: Final = 0.4886025119029199
"""√(3 / (4π))."""

SH_C2: Final = (
    1.0925484305920792,
    -1.0925484305920792,
    0.31539156525252005,
    -1.0925484305920792,
    0.5462742152960396,
)
"""Real spherical harmonics of degree 2 with the signs of Kerbl 2023."""

SH_C3: Final = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)
"""Real spherical harmonics of degree 3 with the signs of Kerbl 2023."""

SH_MAX_DEGREE: Final = 3
"""Degree 3 has 16 coefficients a channel."""

MERGED_ALPHA_MAX: Final = 0.999
"""Largest opacity that a merge gives: above it the logit loses precision and nothing changes on screen (ALPHA_MAX)."""

MERGED_LOG_SCALE_MAX: Final = 80.0
"""Log-scales beyond ± this are clamped while merging: squares and products of scales stay finite in float64."""
