"""Parts of a picture to look at: where it has most detail, and where it has least but is covered."""

import numpy as np

from splatree.shapes import Array, Float32

__all__ = ["busiest", "calmest"]

SHARE = 4
"""A part is this many times narrower and lower than the picture."""
DARK = 0.02
"""A part of a smaller mean is taken for background."""


def busiest(image: Float32[Array, "h w 3"]) -> tuple[slice, slice]:
    """The part with the largest mean gradient."""
    windows, detail, _ = _parts(image)
    return windows[int(np.argmax(detail))]


def calmest(image: Float32[Array, "h w 3"]) -> tuple[slice, slice]:
    """The part with the smallest mean gradient of those that are not background."""
    windows, detail, brightness = _parts(image)
    covered = brightness > DARK
    return windows[int(np.argmin(np.where(covered | ~covered.any(), detail, np.inf)))]


def _parts(image: Array) -> tuple[list[tuple[slice, slice]], Array, Array]:
    """Overlapping parts of the picture, mean gradient and mean brightness of each."""
    grey = np.clip(image, 0, 1).mean(axis=2)
    gradient = np.hypot(*np.gradient(grey))
    height, width = (max(1, size // SHARE) for size in grey.shape)
    tops, lefts = (
        range(0, size - part + 1, max(1, part // 2)) for size, part in zip(grey.shape, (height, width), strict=True)
    )
    windows = [(slice(y, y + height), slice(x, x + width)) for y in tops for x in lefts]
    return windows, np.array([gradient[w].mean() for w in windows]), np.array([grey[w].min() for w in windows])
