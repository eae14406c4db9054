"""Steps of vector quantisation on two levels; `kernels/reference/palette.py` is their specification."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.shapes import Array, Float32, Int32, Int64

__all__ = ["distinct", "label_means", "nearest_few", "nearest_in_groups", "onto_axes", "point_means", "split_groups"]

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


def label_means(
    sh: Float32[Array, "n k 3"],
    weights: Float32[Array, "n"],
    labels: Int32[Array, "n"],
    num_labels: int,
    *,
    threads: int = 0,
) -> Float32[Array, "c k-1 3"]:
    """Weighted mean of the harmonics beyond the DC over the rows of each label; zero where no row has it."""
    means = np.empty((num_labels, sh.shape[1] - 1, 3), np.float32)
    start, rows = _grouped(labels, num_labels)
    _core.label_means(_rows(sh), 3, weights, start, rows, means.reshape(num_labels, -1), threads)
    return means


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


def distinct(sh: Float32[Array, "n k 3"], limit: int) -> tuple[Int32[Array, "n"], Int32[Array, "p"]] | None:
    """Labels of rows whose harmonics beyond the DC have the same bits, and the first row of each; None beyond ``limit``."""
    labels, first_row = np.empty(len(sh), np.int32), np.empty(limit, np.int32)
    count = _core.distinct_rows(_rows(sh), 3, limit, labels, first_row)
    return None if count < 0 else (labels, first_row[:count])


def _rows(sh: Array) -> Array:
    return sh.reshape(len(sh), -1)


def _grouped(labels: Array, num_labels: int) -> tuple[Array, Array]:
    start, rows = np.empty(num_labels + 1, np.int64), np.empty(len(labels), np.int32)
    _core.group_rows(labels, num_labels, start, rows)
    return start, rows
