"""Colours of formats that hold them as bytes, 0 to 1."""

import numpy as np

from splatree.constants import SH_C0
from splatree.shapes import Array, Float32

__all__ = ["num_clipped"]

_CLIP_MIN = 0.5 / 255
"""A colour that is clipped by less is only rounded."""


def num_clipped(dc: Float32[Array, "n 3"]) -> int:
    """How many Gaussians have a colour ½ + C0 dc outside of 0 to 1."""
    color = 0.5 + SH_C0 * dc.astype(np.float64)
    return int(((color < -_CLIP_MIN) | (color > 1 + _CLIP_MIN)).any(axis=1).sum())
