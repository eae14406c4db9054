"""Gaussians in the encoding in which they are stored and trained: the name of a field carries its encoding."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from splatree.constants import SIGMAS
from splatree.errors import ShapeError
from splatree.shapes import Array, Float32, Float64, check_fields, in_short


@dataclass(frozen=True, eq=False)
class Gaussians:
    """Gaussians as columns of ``n`` rows, in the encodings of files.

    Example:
        >>> gaussians = st.read("city.ply").gaussians
        >>> len(gaussians), gaussians.sh_degree
        (253, 3)
        >>> len(gaussians.take(gaussians.opacities() > 0.5)) < len(gaussians)
        True
    """

    means: Float32[Array, "n 3"]
    """Centres, world units."""
    quats: Float32[Array, "n 4"]
    """Rotations wxyz from the Gaussian's axes to the world; any length but zero."""
    log_scales: Float32[Array, "n 3"]
    """Natural logarithm of the standard deviation along each axis, world units."""
    logit_opacities: Float32[Array, "n"]
    """Opacity before the sigmoid: opacity = 1 / (1 + e^−logit)."""
    sh: Float32[Array, "n k 3"]
    """Spherical harmonics, coefficient by coefficient with RGB inside, DC first; k = (degree + 1)², k in 1, 4, 9, 16."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        k = check_fields(self)["k"]
        if k not in (1, 4, 9, 16):
            raise ShapeError(f"Gaussians.sh: found {k} coefficients, wanted 1, 4, 9 or 16 (degree 0 to 3)")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return int(np.sqrt(self.sh.shape[1])) - 1

    @property
    def nbytes(self) -> int:
        """Memory of all columns, bytes."""
        return sum(getattr(self, f.name).nbytes for f in fields(self))

    @property
    def row_bytes(self) -> int:
        """Memory of a row, bytes."""
        return 4 * (11 + 3 * int(self.sh.shape[1]))

    def opacities(self) -> Float64[Array, "n"]:
        """Opacity at the centre of each Gaussian, 0 to 1: the sigmoid of the logit."""
        with np.errstate(over="ignore"):  # exp(800) is infinite and gives 0, as it should
            return np.asarray(1 / (1 + np.exp(-self.logit_opacities.astype(np.float64))))

    def scales(self) -> Float64[Array, "n 3"]:
        """Standard deviation along each axis, world units."""
        return np.asarray(np.exp(self.log_scales.astype(np.float64)))

    def reach(self) -> Float64[Array, "n"]:
        """Three standard deviations along the longest axis of each Gaussian, world units; beyond them it is not drawn."""
        x, y, z = self.log_scales.T
        longest = np.maximum(np.maximum(x, y), z)  # ten times faster than the maximum along an axis of three
        with np.errstate(over="ignore"):
            return np.asarray(SIGMAS * np.exp(longest.astype(np.float64)))

    def take(self, rows: Array) -> "Gaussians":
        """The rows that an index or a mask names, in its order, copied."""
        # np.take copies rows of several values up to ten times faster than indexing with an array does.
        are_numbers = isinstance(rows, np.ndarray) and rows.dtype in (np.int32, np.int64)
        indices = rows if are_numbers else np.arange(len(self))[rows]
        return Gaussians(*(np.take(getattr(self, f.name), indices, axis=0) for f in fields(self)))

    def rows(self, begin: int, end: int) -> "Gaussians":
        """Consecutive rows, as views of the same memory."""
        return Gaussians(*(getattr(self, f.name)[begin:end] for f in fields(self)))

    def with_sh_degree(self, degree: int) -> "Gaussians":
        """The same Gaussians with higher harmonics removed, or missing ones set to zero."""
        if not 0 <= degree <= 3:
            raise ShapeError(f"with_sh_degree: found degree {degree}, wanted 0 to 3")
        k = (degree + 1) ** 2
        if k == self.sh.shape[1]:
            return self
        sh = np.zeros((len(self), k, 3), np.float32)
        shared = min(k, self.sh.shape[1])
        sh[:, :shared] = self.sh[:, :shared]
        return Gaussians(self.means, self.quats, self.log_scales, self.logit_opacities, sh)

    @staticmethod
    def concatenate(parts: Sequence["Gaussians"]) -> "Gaussians":
        """All rows of ``parts`` in order, at the highest degree among them (missing harmonics are zero)."""
        if not parts:
            return Gaussians.empty()
        degree = max(part.sh_degree for part in parts)
        raised = [part.with_sh_degree(degree) for part in parts]
        return Gaussians(*(np.concatenate([getattr(p, f.name) for p in raised]) for f in fields(Gaussians)))

    @staticmethod
    def empty(degree: int = 0) -> "Gaussians":
        """No Gaussians."""
        shapes = ((0, 3), (0, 4), (0, 3), (0,), (0, (degree + 1) ** 2, 3))
        return Gaussians(*(np.zeros(shape, np.float32) for shape in shapes))
