"""How much of each Gaussian can be seen past the others: the definition.

The scene is looked at along eight directions, the diagonals of the world's cubes, both ways, in parallel projection on a plane of
pixels. A Gaussian becomes a splat G in the plane. Its covariance is widened by 0.3 px², and its opacity α is lowered so that it
keeps its mass. From front to back, by the depth of the means, each Gaussian is seen through those before it:

    seen = Σ T G / Σ G over the pixels within 2 σ,    then T ← T (1 − α G)

Hiding fades with the distance behind the Gaussian that hides, 1 − T ← (1 − T) exp(−Δ/reach), because a camera may stand in a room
and not only outside of the scene. The visibility is the root mean square, over the directions, of the shares that are seen.

The plane repeats itself beyond ``width`` pixels, so the few Gaussians far out fall on those of others. A splat is evaluated in at
most 16 pixels to each side. Cost: O(n · pixels) here.
"""

import numpy as np

from splatree.maths.covariance import covariances_from_gaussians
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float64

__all__ = ["measure_visibilities"]

FILTER = 0.3
"""Variance that a cell adds, cells²."""

END_SIGMAS = 2.0
"""Standard deviations at which a splat ends here."""

MOST = 15.5
"""Half the box that a splat is looked at in, at most: cells."""

FRAMES = np.array(
    [
        [[1, -1, 0], [1, 1, -2], [1, 1, 1]],
        [[1, -1, 0], [1, 1, 2], [1, 1, -1]],
        [[1, 1, 0], [1, -1, -2], [1, -1, 1]],
        [[1, 1, 0], [1, -1, 2], [1, -1, -1]],
    ],
    np.float64,
)
"""u, v and the direction of sight of each axis, to be normalised."""


def measure_visibilities(
    gaussians: Gaussians, middle: Float64[Array, "3"], *, cell: float, reach: float, width: int
) -> Float64[Array, "n"]:
    """The visibility of each Gaussian, 0 to 1. Lengths in world units; ``width`` of the plane in cells."""
    means = (gaussians.means.astype(np.float64) - middle) / cell
    covariances = covariances_from_gaussians(gaussians.quats, gaussians.log_scales) / cell**2
    alphas = gaussians.opacities()
    squares = np.zeros(len(gaussians))
    for frame in FRAMES:
        frame = frame / np.linalg.norm(frame, axis=1, keepdims=True)
        places = means @ frame.T
        places[:, :2] += width / 2
        flat = frame[:2] @ covariances @ frame[:2].T
        wide = flat + FILTER * np.eye(2)
        opacities = alphas * np.sqrt(np.maximum(np.linalg.det(flat), 0) / np.linalg.det(wide))
        order = np.argsort(places[:, 2], kind="stable")
        for rows in (order, order[::-1]):
            passing, depths = np.ones((width, width)), np.zeros((width, width))
            for i in rows:
                half = np.minimum(END_SIGMAS * np.sqrt(np.diag(wide[i])), MOST)
                first, last = (np.floor(places[i, :2] + side * half).astype(int) for side in (-1, 1))
                u, v = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)), indexing="ij")
                apart = np.stack([u, v], axis=-1) + 0.5 - places[i, :2]
                powers = np.einsum("uvi,ij,uvj->uv", apart, np.linalg.inv(wide[i]), apart)
                inside = powers <= END_SIGMAS**2
                u, v, g = u[inside] % width, v[inside] % width, np.exp(-powers[inside] / 2)
                hidden = (1 - passing[u, v]) * np.exp(-np.abs(places[i, 2] - depths[u, v]) * cell / reach)
                passing[u, v] = (1 - hidden) * (1 - opacities[i] * g)
                depths[u, v] = places[i, 2]
                seen = np.sum(g * (1 - hidden)) / np.sum(g) if len(g) else 1.0
                squares[i] += seen**2
    return np.sqrt(squares / (2 * len(FRAMES)))
