"""Exposure: what each photograph does to the colours that all of them show.

``gain``: a factor for each channel. The one that fits a picture X best to its photograph Y is Σ X Y / Σ X², in closed form.

``affine``: Y ≈ M X + b, with a matrix M of 3 × 3: white balance and haze, too. It is the least of

    Σ |M X + b − Y|² + κ n |(M, b) − (diag(gain), 0)|²

over n pixels, so what the pixels do not tell stays a gain. Both are 3 × 4 matrices here.

Each visit of a photograph mixes its matrix in with the weight max(0.1, 1 / visits). The scene shows the mean exposure: over the
photographs that have been visited, the geometric mean of the gains or the mean of the matrices is held at 1, or brightness could
wander between exposures and colours.
"""

from dataclasses import dataclass

import numpy as np

from splatree.scene.gradients import PhotoLoss
from splatree.shapes import Array, Bool, Float32, Float64, Int32, UInt8, check_fields

__all__ = ["GAIN_RANGE", "Exposures", "exposed", "is_gain"]

LEAST_WEIGHT = 0.1
"""Weight of the newest matrix once a photograph was visited often."""

GAIN_RANGE = (0.1, 10.0)
"""Factors beyond are those of pictures that show nothing yet."""

PRIOR = 0.002
"""κ, in squares of the full range: about the variance of colours in a photograph, and far less than that of its brightness."""

_IDENTITY = np.eye(3, 4)


@dataclass(frozen=True, eq=False)
class Exposures:
    """Those of all photographs; arrays change in place."""

    matrices: Float64[Array, "p 3 4"]
    """As they were found, before their mean is taken off."""
    visits: Int32[Array, "p"]
    """How often each photograph was visited."""
    is_affine: bool = False
    """Whether they are more than gains."""

    def __post_init__(self) -> None:
        check_fields(self)

    @staticmethod
    def none(num_photos: int, *, is_affine: bool = False) -> "Exposures":
        """Of photographs that were never visited."""
        return Exposures(np.tile(_IDENTITY, (num_photos, 1, 1)), np.zeros(num_photos, np.int32), is_affine)

    def of(self, i: int) -> Float64[Array, "3 4"]:
        """What a photograph does to the colours of the scene; the identity for one that was never visited."""
        return np.array(self.relative()[i])

    def relative(self) -> Float64[Array, "p 3 4"]:
        """All of them, with a mean of 1 over the photographs that were visited."""
        visited = self.visits > 0
        if not visited.any():
            return np.tile(_IDENTITY, (len(self.visits), 1, 1))
        found = self.matrices[visited]
        mean = np.eye(4)
        if self.is_affine:
            mean[:3] = found.mean(axis=0)
        else:
            mean[:3, :3] = np.diag(np.exp(np.log(np.diagonal(found, axis1=1, axis2=2)).mean(axis=0)))
        last = np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(self.visits), 1, 1))
        whole = np.concatenate([self.matrices, last], axis=1) @ np.linalg.inv(mean)
        return np.where(visited[:, None, None], whole[:, :3], _IDENTITY)

    def visit(
        self,
        i: int,
        loss: PhotoLoss,
        image: Float32[Array, "h w 3"],
        photo: UInt8[Array, "h w 3"],
        mask: Bool[Array, "h w"] | None = None,
    ) -> None:
        """Mix in the matrix that fits best now.

        Args:
            i: the photograph.
            loss: of the picture as drawn, or as exposed; its sums are those of the picture that was compared.
            image: the picture as drawn.
            photo: the photograph.
            mask: pixels that count; None: all.
        """
        best = _fitted(image, photo, mask) if self.is_affine else _gain(loss.products, loss.squares)
        self.visits[i] += 1
        weight = max(LEAST_WEIGHT, 1 / int(self.visits[i]))
        self.matrices[i] += weight * (best - self.matrices[i])


def exposed(image: Float32[Array, "h w 3"], matrix: Float64[Array, "3 4"]) -> Float32[Array, "h w 3"]:
    """A picture as a photograph of that exposure would show it."""
    return np.ascontiguousarray(image @ matrix[:, :3].T.astype(np.float32) + matrix[:, 3].astype(np.float32))


def is_gain(matrix: Float64[Array, "3 4"]) -> bool:
    """Whether an exposure is but a factor for each channel."""
    return bool((matrix == matrix * _IDENTITY).all())


def _gain(products: Array, squares: Array) -> Float64[Array, "3 4"]:
    best = np.divide(products, squares, out=np.ones(3), where=squares > 0)
    return np.clip(best, *GAIN_RANGE)[:, None] * _IDENTITY


def _fitted(image: Array, photo: Array, mask: Array | None) -> Float64[Array, "3 4"]:
    """M and b of the least squares towards the gains."""
    x, y = image.reshape(-1, 3), photo.reshape(-1, 3).astype(np.float32) / np.float32(255)
    if mask is not None:
        x, y = x[mask.ravel()], y[mask.ravel()]
    if not len(x):
        return np.array(_IDENTITY)
    x = np.concatenate([x, np.ones((len(x), 1), np.float32)], axis=1)
    squares, products = (x.T @ x).astype(np.float64), (y.T @ x).astype(np.float64)
    gain = _gain(np.diagonal(products), np.diagonal(squares)[:3])
    prior = PRIOR * len(x)
    found = np.linalg.solve(squares + prior * np.eye(4), (products + prior * gain).T).T
    return found if np.isfinite(found).all() and np.linalg.det(found[:, :3]) > GAIN_RANGE[0] ** 3 else gain
