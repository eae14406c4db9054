"""Gaussians put to their place by matrices of a file, in float64, and rounded once, relative to an origin if they lie far off.

A file or a tileset has pieces, each with a matrix of its own. They are gone through in chunks: once for a sample that the origin
is found from, if any piece is moved, and then as often as the rows are asked for.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from splatree.edit.similarity import Similarity
from splatree.edit.stretch import Stretch
from splatree.errors import FormatError
from splatree.io.check import checked_rows
from splatree.io.chunks import Chunks, Counts, counted_chunks
from splatree.io.options import Repair
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.origin import NO_ORIGIN, Origin, origin_of
from splatree.shapes import Array, Float64

__all__ = ["STRETCHED", "Piece", "Place", "placed_chunks", "stretches"]

_ROWS_OF_SAMPLE = 1 << 16

_FLAT = 1e-7
"""Smallest scale of a matrix over its largest: below the rounding of float32, in which matrices are stored, it is flat."""


@dataclass(frozen=True, eq=False)
class Place:
    """What turns, scales and moves Gaussians, and mirrors or stretches them."""

    shape: Similarity | Stretch
    """What is done to shapes and harmonics."""
    matrix: Float64[Array, "4 4"]
    """All of it and the move, in the axes of our scenes."""
    origin: Origin
    """What the means are relative to before."""

    @staticmethod
    def of(matrix: Float64[Array, "4 4"], where: str, *, origin: Origin = NO_ORIGIN) -> "Place | None":
        """The place that a matrix of a file says; None: everything stays where it is.

        Raises:
            FormatError: it flattens what it moves.
        """
        linear = matrix[:3, :3]
        if np.array_equal(matrix, np.eye(4)) and origin == NO_ORIGIN:
            return None
        sizes = _sizes(linear)
        if sizes[2] <= _FLAT * sizes[0]:
            raise FormatError(
                f"{where}: found a node that flattens it ({linear.tolist()}), wanted a matrix with an inverse"
            )
        scale = float(np.exp(np.log(sizes).mean()))
        if np.linalg.det(linear / scale) < 0 or stretches(matrix):
            return Place(Stretch(np.ascontiguousarray(linear)), matrix, origin)
        return Place(Similarity(scale, linear / scale), matrix, origin)

    def means(self, gaussians: Gaussians) -> Float64[Array, "n 3"]:
        """Where the means go. No matrix product: its bits depend on how many rows there are."""
        x, y, z = (gaussians.means.astype(np.float64) + np.asarray(self.origin)).T
        axes = [row[0] * x + row[1] * y + row[2] * z for row in self.matrix[:3, :3]]
        return np.stack(axes, axis=1) + self.matrix[:3, 3]


def stretches(matrix: Float64[Array, "4 4"]) -> bool:
    """Whether a matrix stretches or shears, so that harmonics do not follow exactly; it may mirror."""
    sizes = _sizes(matrix[:3, :3])
    return bool(sizes[2] < (1 - 1e-5) * sizes[0])  # within float32, as which matrices are stored


def _sizes(linear: Float64[Array, "3 3"]) -> Float64[Array, "3"]:
    """The factors by which a map stretches, the largest first; 0 of one that overflows."""
    return np.asarray(np.linalg.svd(linear, compute_uv=False) if np.isfinite(linear).all() else np.zeros(3))


STRETCHED = (
    "how colours change with the direction, where nodes stretch or shear: harmonics are turned with the nearest rotation; "
    "shapes are exact"
)
"""What is lost of Gaussians with harmonics under a matrix that stretches."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Some Gaussians of a file that stand together."""

    num_rows: int
    """How many there are."""
    sh_degree: int
    """Degree of their harmonics."""
    make: Callable[[], Iterator[tuple[Gaussians, Counts]]]
    """Start a pass over them, in chunks, with what reading had to change in each."""
    place: Place | None
    """Where they go; None: they stay where they are."""


def placed_chunks(
    opened: Callable[[], AbstractContextManager[Sequence[Piece]]],
    where: str,
    mode: Mode,
    metadata: Mapping[str, str],
    *,
    repair: Repair,
) -> Chunks:
    """The Gaussians of all pieces where they belong, their values checked, as one scene in chunks.

    Args:
        opened: opens the pieces for a pass.
        where: the file, as errors name it.
        mode: how the scene is drawn.
        metadata: as that of `Source`.
        repair: what to do about values that cannot be used.

    Raises:
        FormatError: a value cannot be used.
    """
    with opened() as pieces:
        num_rows, degree = sum(piece.num_rows for piece in pieces), max(piece.sh_degree for piece in pieces)
        origin = _origin_of(pieces, num_rows) if any(piece.place is not None for piece in pieces) else NO_ORIGIN

    def parts() -> Iterator[tuple[Gaussians, Counts]]:
        first = 0
        with opened() as pieces:
            for piece in pieces:
                for gaussians, counts in piece.make():
                    settled = _settled(gaussians.with_sh_degree(degree), piece.place, origin)
                    kept, more = checked_rows(settled, where, repair=repair, first_row=first)
                    first += len(gaussians)
                    yield kept, dict(Counter(counts) + Counter(more))

    return counted_chunks(parts, num_rows, degree, mode, metadata, drops_rows=bool(repair), origin=origin)


def _origin_of(pieces: Sequence[Piece], num_rows: int) -> Origin:
    """The origin, from a sample of the rows of each piece."""
    every = max(1, num_rows // _ROWS_OF_SAMPLE)
    means, log_scales = list[Array](), list[Array]()
    for piece in pieces:
        begin = 0
        for gaussians, _ in piece.make():
            sample = gaussians.take(np.arange(-begin % every, len(gaussians), every))
            begin += len(gaussians)
            with np.errstate(all="ignore"):  # whatever comes of absurd values is found by the check of values
                at_place = sample if piece.place is None else piece.place.shape.gaussians(sample)
                means.append(sample.means.astype(np.float64) if piece.place is None else piece.place.means(sample))
            log_scales.append(at_place.log_scales)
    return origin_of(np.concatenate(means), np.concatenate(log_scales)) if means else NO_ORIGIN


def _settled(gaussians: Gaussians, place: Place | None, origin: Origin) -> Gaussians:
    if place is None and origin == NO_ORIGIN:
        return gaussians
    with np.errstate(all="ignore"):
        world = gaussians.means.astype(np.float64) if place is None else place.means(gaussians)
        if place is not None:
            gaussians = place.shape.gaussians(gaussians)
        return replace(gaussians, means=(world - np.asarray(origin)).astype(np.float32))
