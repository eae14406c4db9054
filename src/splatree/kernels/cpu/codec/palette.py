"""Steps of vector quantisation on two levels; `kernels/reference/palette.py` is their specification."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array, Float32, Float64, Int32, Int64

__all__ = [
    "DistinctRows",
    "add_to_sums",
    "nearest_few",
    "nearest_in_groups",
    "onto_axes",
    "point_means",
    "split_groups",
]

_LANES = 16


def onto_axes(sh: Float32[Array, "n k 3"], origin: Array, axes: Array, *, threads: int = 0) -> Float32[Array, "n d"]:
    """Harmonics beyond the DC in the coordinates of ``axes`` (3(k−1) d), less ``origin``."""
    padded = np.zeros((axes.shape[0], -(-axes.shape[1] // _LANES) * _LANES), np.float32)
    padded[:, : axes.shape[1]] = axes
    points = np.empty((len(sh), axes.shape[1]), np.float32)
    _core.onto_axes(_rows(sh), 3, origin.astype(np.float32), padded, points, threads)
    return points


def nearest_few(
    points: Float32[Array, "n d"], centres: Float32[Array, "c d"], count: int, *, threads: int = 0
) -> Int32[Array, "n p"]:
    """The ``count`` nearest centres of each point, nearest first, at most one of each class of numbers modulo 16."""
    near = np.empty((len(points), min(count, len(centres), _LANES)), np.int32)
    _core.nearest_few(points, centres, near, threads)
    return near


def split_groups(
    points: Float32[Array, "n d"],
    weights: Float32[Array, "n"],
    group_from_point: Int32[Array, "n"],
    first_centre: Int64[Array, "g+1"],
    *,
    iterations: int,
    threads: int = 0,
) -> Float32[Array, "c d"]:
    """Centres of each group by weighted K-means, started from points evenly spread along the group's running weight."""
    centres = np.empty((int(first_centre[-1]), points.shape[1]), np.float32)
    start, rows = _grouped(group_from_point, len(first_centre) - 1)
    _core.split_groups(points, weights, start, rows, first_centre, iterations, centres, threads)
    return centres


def nearest_in_groups(
    points: Float32[Array, "n d"],
    centres: Float32[Array, "c d"],
    first_centre: Int64[Array, "g+1"],
    near: Int32[Array, "n p"],
    *,
    threads: int = 0,
) -> Int32[Array, "n"]:
    """The nearest centre of each point among those of the groups that ``near`` names for it."""
    labels = np.zeros(len(points), np.int32)
    _core.nearest_in_groups(points, centres, first_centre, near, labels, threads)
    return labels


def point_means(
    points: Float32[Array, "n d"],
    weights: Float32[Array, "n"],
    labels: Int32[Array, "n"],
    num_labels: int,
    *,
    threads: int = 0,
) -> Float32[Array, "c d"]:
    """Weighted mean of the points of each label; zero where none has it."""
    means = np.empty((num_labels, points.shape[1]), np.float32)
    start, rows = _grouped(labels, num_labels)
    _core.label_means(points, 0, weights, start, rows, means, threads)
    return means


def add_to_sums(
    sh: Float32[Array, "n k 3"], weights: Float32[Array, "n"], labels: Int32[Array, "n"], sums: Float64[Array, "c w"]
) -> None:
    """Add the weighted harmonics beyond the DC of each row to the sums of its label, and its weight to the last of these."""
    _core.add_to_sums(_rows(sh), 3, weights, labels, sums)


class DistinctRows:
    """Numbers rows whose harmonics beyond the DC have the same bits alike, part by part."""

    def __init__(self, num_rest: int, limit: int) -> None:
        """For at most ``limit`` different rows of ``num_rest`` values."""
        self._entries = np.empty((limit, num_rest), np.float32)
        self._label_from_slot = np.full(1 << max(6, (2 * limit - 1).bit_length()), -1, np.int32)
        self._count = 0

    def number(self, sh: Float32[Array, "n k 3"]) -> Int32[Array, "n"] | None:
        """Numbers by the first appearance in any part; None once there are more different rows than the limit."""
        labels = np.empty(len(sh), np.int32)
        if self._count >= 0:
            args = (_rows(sh), 3, self._entries, self._label_from_slot, self._count)
            self._count = _core.distinct_rows(*args, labels)
        return labels if self._count >= 0 else None

    @property
    def entries(self) -> Float32[Array, "p w"]:
        """The different rows."""
        return self._entries[: self._count].copy()


def _rows(sh: Array) -> Array:
    return sh.reshape(len(sh), -1)


def _grouped(labels: Array, num_labels: int) -> tuple[Array, Array]:
    start, rows = np.empty(num_labels + 1, np.int64), np.empty(len(labels), np.int32)
    _core.group_rows(labels, num_labels, start, rows)
    return start, rows
