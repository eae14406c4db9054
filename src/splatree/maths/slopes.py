"""The slopes x / z at which the projection's derivative is taken.

A Gaussian far outside of the image would be drawn as a streak across it, because the derivative of x / z grows with x / z. So the
slope is held within the image and a margin of 0.3 half fields of view on each side (Kerbl 2023, the released code).
"""

from splatree.constants import FRUSTUM_CLAMP

__all__ = ["held_slopes"]


def held_slopes(focal: float, centre: float, size: int) -> tuple[float, float]:
    """The least and the largest slope along one axis of an image; the arguments are in px.

    Example:
        >>> held_slopes(focal=100.0, centre=50.0, size=100)
        (-0.65, 0.65)
    """
    before, after = centre / focal, (size - centre) / focal
    margin = (FRUSTUM_CLAMP - 1.0) * (before + after) / 2
    return -before - margin, after + margin
