"""Exposure: how much brighter each photograph is than the others, by a factor for each channel.

The factor that fits a picture X best to its photograph Y is Σ X Y / Σ X², in closed form. Each visit of a photograph mixes it in
with the weight max(0.1, 1 / visits). The scene shows the mean exposure: the geometric mean of the factors over the
photographs that have been visited is held at 1, or brightness could wander between the factors and the colours.
"""

from dataclasses import dataclass

import numpy as np

from splatree.scene.gradients import PhotoLoss
from splatree.shapes import Array, Float64, Int32, check_fields

__all__ = ["GAIN_RANGE", "Gains"]

LEAST_WEIGHT = 0.1
"""Weight of the newest factor once a photograph was visited often."""

GAIN_RANGE = (0.1, 10.0)
"""Factors beyond are those of pictures that show nothing yet."""


@dataclass(frozen=True, eq=False)
class Gains:
    """Factors of all photographs; arrays change in place."""

    factors: Float64[Array, "p 3"]
    """As they were found, before their mean is taken off."""
    visits: Int32[Array, "p"]
    """How often each photograph was visited."""

    def __post_init__(self) -> None:
        check_fields(self)

    @staticmethod
    def ones(num_photos: int) -> "Gains":
        """Of photographs that were never visited."""
        return Gains(np.ones((num_photos, 3)), np.zeros(num_photos, np.int32))

    def of(self, i: int) -> Float64[Array, "3"]:
        """The factor of a photograph, by which its picture is multiplied; 1 for one that was never visited."""
        return np.array(self.relative()[i])

    def relative(self) -> Float64[Array, "p 3"]:
        """All factors, with a geometric mean of 1 over the photographs that were visited."""
        visited = self.visits > 0
        if not visited.any():
            return np.ones_like(self.factors)
        mean = np.exp(np.log(self.factors[visited]).mean(axis=0))
        return np.where(visited[:, None], self.factors / mean, 1.0)

    def visit(self, i: int, loss: PhotoLoss) -> None:
        """Mix in the factor that fits best now."""
        best = np.divide(loss.products, loss.squares, out=np.ones(3), where=loss.squares > 0)
        self.visits[i] += 1
        weight = max(LEAST_WEIGHT, 1 / int(self.visits[i]))
        self.factors[i] += weight * (np.clip(best, *GAIN_RANGE) - self.factors[i])
