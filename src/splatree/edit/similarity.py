"""A scene scaled, turned and moved: x' = s R x + t.

Means move with the points of space, log scales grow by log s, quaternions are multiplied by that of R, and the harmonics of
each degree by its Wigner matrix (`maths.harmonics.rotations_of_harmonics`); opacities stay. Exact up to the rounding of float32.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from splatree.edit.options import EditOptions
from splatree.kernels.cpu.codec.rotate import rotate_harmonics
from splatree.maths.harmonics import rotations_of_harmonics
from splatree.maths.rotations import matrix_from_angles, quat_from_matrix
from splatree.scene.gaussians import Gaussians
from splatree.scene.origin import NO_ORIGIN, Origin, settled
from splatree.scene.scene import NEAR_KEY, Source
from splatree.shapes import Array, Bool, Float32, Float64, check_fields

__all__ = ["Move", "Similarity", "move_from_options"]


@dataclass(frozen=True, eq=False)
class Similarity:
    """A map of space that keeps angles."""

    scale: float = 1.0
    """s."""
    rotation: Float64[Array, "3 3"] = field(default_factory=lambda: np.eye(3))
    """R."""
    translation: Float64[Array, "3"] = field(default_factory=lambda: np.zeros(3))
    """t, world units."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def is_identity(self) -> bool:
        """Whether it leaves every point where it is."""
        return self.scale == 1 and not bool(self.translation.any()) and np.array_equal(self.rotation, np.eye(3))

    def points(self, points: Float32[Array, "n 3"]) -> Float32[Array, "n 3"]:
        """Where points go."""
        moved = np.empty_like(points)
        linear = self.scale * self.rotation
        x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
        with np.errstate(over="ignore"):  # beyond float32 they are infinite, as the check of values says
            for axis in range(3):
                a, b, c = linear[axis]
                moved[:, axis] = a * x + b * y + c * z + self.translation[axis]
        return moved

    def moved(self, g: Gaussians) -> Float32[Array, "n 3"]:
        """Where the means go; the means themselves if nothing moves."""
        return g.means if self.is_identity else self.points(g.means)

    def gaussians(self, g: Gaussians, means: Float32[Array, "n 3"] | None = None) -> Gaussians:
        """Gaussians moved with space; ``means`` if they were moved already."""
        means = self.points(g.means) if means is None else means
        log_scales = g.log_scales
        if self.scale != 1:
            log_scales = log_scales + np.float32(math.log(self.scale))
        if np.array_equal(self.rotation, np.eye(3)):
            return Gaussians(means, g.quats, log_scales, g.logit_opacities, g.sh)
        matrices = rotations_of_harmonics(self.rotation, g.sh_degree)
        sh = rotate_harmonics(g.sh, matrices) if matrices else g.sh
        return Gaussians(means, _products(quat_from_matrix(self.rotation), g.quats), log_scales, g.logit_opacities, sh)

    def curves(self, curves: Float32[Array, "n 4"] | None) -> Float32[Array, "n 4"] | None:
        """Curves of nodes (`GaussianTree.curves`): the first and the last are areas."""
        if curves is None or self.scale == 1:
            return curves
        return np.asarray(curves * np.array([self.scale**2, 1, 1, self.scale**2], np.float32))

    @staticmethod
    def reach(means: Float32[Array, "n 3"]) -> np.float32:
        """The largest coordinate of moved means, whose rounding `extents` covers."""
        return np.float32(np.abs(means).max(initial=0))

    def extents(
        self, extents: Float32[Array, "n"], reach: np.float32, is_level: Bool[Array, "n"]
    ) -> Float32[Array, "n"]:
        """Extents that are ``is_level`` belong to levels, and are scaled.

        All others are radii of balls around moved means, raised by what the rounding of any of them may have moved a descendant
        away.
        """
        # Two means, each rounded by at most half an ulp a coordinate, and the product: 2⁻²⁴ of the coordinates and 2⁻²³ of the
        # radius, taken four times as large.
        balls = extents * np.float32(self.scale * (1 + 2**-21)) + np.float32(reach * 2**-21)
        return np.where(is_level, extents * np.float32(self.scale), balls).astype(np.float32)

    def metadata(self, metadata: Mapping[str, str]) -> Mapping[str, str]:
        """What is known of the scene, with the depth that it is drawn from scaled."""
        if NEAR_KEY not in metadata or self.scale == 1:
            return metadata
        return {**metadata, NEAR_KEY: str(self.scale * Source(metadata=metadata).near)}


@dataclass(frozen=True, eq=False)
class Move:
    """A map of the world as it is done to a scene with an origin: x + o → x' + o'."""

    similarity: Similarity
    """What is done to the rows."""
    origin: Origin
    """o', the origin of the scene after it."""


def move_from_options(options: EditOptions, origin: Origin = NO_ORIGIN) -> Move:
    """The map that the options name, of a scene with an origin.

    With x the means and o the origin, s R (x + o) + t = s R x + (s R o + t): the last sum, in float64, becomes the new origin,
    and on axes where it has become small a translation of the rows.
    """
    rotation, translation = matrix_from_angles(options.rotate), np.asarray(options.translate, np.float64)
    target = options.scale * rotation @ np.asarray(origin) + translation if origin != NO_ORIGIN else translation
    moved, rest = settled(target, origin)
    return Move(Similarity(options.scale, rotation, rest), moved)


def _products(p: Float64[Array, "4"], quats: Float32[Array, "n 4"]) -> Float32[Array, "n 4"]:
    """Hamilton products p q: first the rotation of q, then that of p."""
    w, x, y, z = (quats[:, i].astype(np.float64) for i in range(4))
    out = np.empty_like(quats)
    out[:, 0] = p[0] * w - p[1] * x - p[2] * y - p[3] * z
    out[:, 1] = p[0] * x + p[1] * w + p[2] * z - p[3] * y
    out[:, 2] = p[0] * y - p[1] * z + p[2] * w + p[3] * x
    out[:, 3] = p[0] * z + p[1] * y - p[2] * x + p[3] * w
    return out
