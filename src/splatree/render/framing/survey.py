"""A scene seen as a statistician sees it: a sample of its leaves, with what framing asks of them.

Framing needs where the opaque surface lies, which way it faces and from where it was photographed. All three are averages
over leaves, so 60,000 leaves, evenly spread over the rows, answer them.

A leaf weighs its opacity times its area, the product of its two longest half axes. Areas are capped at the 95 % quantile, or a
few sheets of fog would outweigh the rest.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from splatree.errors import InputError
from splatree.maths.harmonics import basis_from_directions
from splatree.maths.rotations import matrices_from_quats
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64, check_fields

__all__ = ["Survey", "survey_of", "weighted_quantiles"]

SAMPLE: Final = 60_000
"""Leaves looked at: quantiles then err by less than 1 % of the radius."""

AREA_CAP: Final = 0.95
"""Areas above this quantile count as this quantile."""

GLIMMER: Final = 1e-3
"""Added to both magnitudes of a ratio of view-dependent colour: a quarter of a step of 8 bits."""


@dataclass(frozen=True, eq=False)
class Survey:
    """A sample of the leaves of a scene."""

    gaussians: Gaussians
    """The leaves in the sample."""
    spacing: float
    """How many leaves of the scene stand behind one of the sample."""
    means: Float64[Array, "n 3"]
    """Their centres, world units."""
    opacities: Float64[Array, "n"]
    """Opacity of each, 0 to 1."""
    weights: Float64[Array, "n"]
    """Opacity times area; they add up to 1."""
    normals: Float64[Array, "n 3"]
    """Unit vector along the shortest axis of each; which of the two ends it points to means nothing."""
    flatness: Float64[Array, "n"]
    """1 − shortest half axis / middle half axis: 1 for a disc, 0 for a ball or a needle."""

    def __post_init__(self) -> None:
        check_fields(self)

    def gaze(self, eye: Array) -> float:
        """Whether the scene was photographed from the side of ``eye``: above 0 if it was, below 0 if from the far side.

        Training starts the harmonics above degree 0 at zero and moves them by what photographs ask for. They grow in the
        directions that were photographed, and least in the opposite ones. The value is the mean of the logarithm of the
        view-dependent colour towards ``eye`` over that away from it: about ±0.7 for a scene photographed from one side, 0
        where nothing is known (also without harmonics).
        """
        few = self._few
        along = self.means[few] - np.asarray(eye, np.float64)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        basis = basis_from_directions(along, self.gaussians.sh_degree)
        # Harmonics of odd degree change their sign with the direction.
        even, odd = (
            np.einsum("nk,nkc->nc", basis[:, columns], self._harmonics[:, columns]) for columns in self._even_and_odd
        )
        towards, away = (np.linalg.norm(color, axis=1) for color in (even + odd, even - odd))
        ratio = np.log((towards + GLIMMER) / (away + GLIMMER))
        return float(np.average(ratio, weights=self.opacities[few]))

    def gaze_along(self, directions: Float64[Array, "d 3"]) -> Float64[Array, "d"]:
        """Mean magnitude of the view-dependent colour for looks along each direction; zeros without harmonics."""
        few = self._few
        basis = basis_from_directions(directions, self.gaussians.sh_degree)
        basis[:, 0] = 0
        seen = np.tensordot(basis, self._harmonics, axes=(1, 1))  # [d n 3]
        return np.asarray(np.average(np.linalg.norm(seen, axis=2), axis=1, weights=self.opacities[few]))

    @property
    def _few(self) -> slice:
        """About 8,000 rows: means over them err by 1 %."""
        return slice(None, None, max(1, len(self.means) // 8000))

    @cached_property
    def _harmonics(self) -> Float64[Array, "n k 3"]:
        """Those of these rows."""
        return self.gaussians.sh[self._few].astype(np.float64)

    @property
    def _even_and_odd(self) -> tuple[list[int], list[int]]:
        """Which harmonics are of even degree, and which of odd; not that of degree 0."""
        degrees = np.sqrt(np.arange(self.gaussians.sh.shape[1])).astype(int)
        return [k for k, d in enumerate(degrees) if d and d % 2 == 0], [k for k, d in enumerate(degrees) if d % 2]


def survey_of(scene: Scene) -> Survey:
    """Look at a sample of the leaves.

    Raises:
        InputError: the scene is empty.
    """
    leaves = np.flatnonzero(scene.tree.is_leaf)
    if len(leaves) == 0:
        raise InputError("framing: the scene is empty, so there is nothing to look at; name cameras instead")
    rows = leaves[:: -(-len(leaves) // SAMPLE)]
    g = scene.gaussians.take(rows)
    opacities = 1 / (1 + np.exp(-np.clip(g.logit_opacities.astype(np.float64), -30, 30)))
    order = np.argsort(g.log_scales, axis=1, kind="stable")
    half_axes = np.exp(np.take_along_axis(g.log_scales, order, axis=1).astype(np.float64))  # [n 3], shortest first
    areas = half_axes[:, 1] * half_axes[:, 2]
    weights = opacities * np.minimum(areas, np.quantile(areas, AREA_CAP))
    normals = np.take_along_axis(matrices_from_quats(g.quats), order[:, None, :1], axis=2)[..., 0]
    return Survey(
        gaussians=g,
        spacing=len(leaves) / len(rows),
        means=g.means.astype(np.float64),
        opacities=opacities,
        weights=np.asarray(weights / weights.sum()),
        normals=normals,
        flatness=1 - half_axes[:, 0] / half_axes[:, 1],
    )


def weighted_quantiles(values: Array, weights: Array, shares: tuple[float, ...]) -> list[float]:
    """The values below which these shares of the weight lie."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    places = np.searchsorted(below, np.asarray(shares) * below[-1])
    return [float(values[order[min(place, len(order) - 1)]]) for place in places]
