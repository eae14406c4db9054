"""Steps of vector quantisation on two levels: what the fast kernels must give, up to points that lie between two centres."""

import numpy as np

from splatree.shapes import Array, Float32, Float64, Int32, Int64

_CLASSES = 16


def onto_axes(sh: Float32[Array, "n k 3"], origin: Array, axes: Array, *, threads: int = 0) -> Float32[Array, "n d"]:
    """Harmonics beyond the DC in the coordinates of ``axes`` (3(k−1) d), less ``origin``."""
    return np.asarray((_rest(sh) - origin) @ axes, np.float32)


def nearest_few(
    points: Float32[Array, "n d"], centres: Float32[Array, "c d"], count: int, *, threads: int = 0
) -> Int32[Array, "n p"]:
    """The ``count`` nearest centres of each point, nearest first, at most one of each class of numbers modulo 16."""
    near = np.empty((len(points), min(count, len(centres), _CLASSES)), np.int32)
    for i, distances in enumerate(_squared_distances(points, centres)):
        best = [c + _CLASSES * int(np.argmin(distances[c::_CLASSES])) for c in range(min(_CLASSES, len(centres)))]
        near[i] = sorted(best, key=lambda c: (distances[c], c))[: near.shape[1]]
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
    for g in range(len(first_centre) - 1):
        own = centres[first_centre[g] : first_centre[g + 1]]
        members = np.flatnonzero(group_from_point == g)
        x, w = points[members].astype(np.float64), weights[members].astype(np.float64)
        own[:] = x[_spread(w, len(own))]
        for _ in range(iterations):
            labels = _squared_distances(x, own).argmin(axis=1)
            for c in np.unique(labels):
                own[c] = np.average(x[labels == c], axis=0, weights=w[labels == c])
    return centres


def _spread(weights: Array, count: int) -> Array:
    """Points at which the running weight passes (j + ½) / count of all; the last ones wherever no more are left than wanted."""
    chosen: list[int] = []
    for i, running in enumerate(np.cumsum(weights)):
        if len(chosen) == count:
            break
        if running * count >= (len(chosen) + 0.5) * weights.sum() or len(weights) - i <= count - len(chosen):
            chosen.append(i)
    return np.array(chosen, np.intp)


def nearest_in_groups(
    points: Float32[Array, "n d"],
    centres: Float32[Array, "c d"],
    first_centre: Int64[Array, "g+1"],
    near: Int32[Array, "n p"],
    *,
    threads: int = 0,
) -> Int32[Array, "n"]:
    """The nearest centre of each point among those of the groups that ``near`` names for it."""
    distances = _squared_distances(points, centres)
    group_from_centre = np.repeat(np.arange(len(first_centre) - 1), np.diff(first_centre))
    searched = (group_from_centre[None, :, None] == near[:, None, :]).any(axis=2)
    return np.asarray(np.where(searched, distances, np.inf).argmin(axis=1), np.int32)


def point_means(
    points: Float32[Array, "n d"],
    weights: Float32[Array, "n"],
    labels: Int32[Array, "n"],
    num_labels: int,
    *,
    threads: int = 0,
) -> Float32[Array, "c d"]:
    """Weighted mean of the points of each label; zero where none has it."""
    means = np.zeros((num_labels, points.shape[1]))
    for label in np.unique(labels):
        rows = labels == label
        means[label] = np.average(points[rows].astype(np.float64), axis=0, weights=weights[rows])
    return means.astype(np.float32)


def add_to_sums(
    sh: Float32[Array, "n k 3"], weights: Float32[Array, "n"], labels: Int32[Array, "n"], sums: Float64[Array, "c w"]
) -> None:
    """Add the weighted harmonics beyond the DC of each row to the sums of its label, and its weight to the last of these."""
    with_one = np.hstack([_rest(sh), np.ones((len(sh), 1))])
    np.add.at(sums, labels, weights[:, None] * with_one)


class DistinctRows:
    """Numbers rows whose harmonics beyond the DC have the same bits alike, part by part."""

    def __init__(self, num_rest: int, limit: int) -> None:
        """For at most ``limit`` different rows of ``num_rest`` values."""
        self._num_rest, self._limit = num_rest, limit
        self._label_from_bits: dict[bytes, int] = {}

    def number(self, sh: Float32[Array, "n k 3"]) -> Int32[Array, "n"] | None:
        """Numbers by the first appearance in any part; None once there are more different rows than the limit."""
        known = self._label_from_bits
        labels = np.array([known.setdefault(row[1:].tobytes(), len(known)) for row in sh], np.int32)
        return labels if len(known) <= self._limit else None

    @property
    def entries(self) -> Float32[Array, "p w"]:
        """The different rows."""
        return np.frombuffer(b"".join(self._label_from_bits), np.float32).reshape(-1, self._num_rest)


def _rest(sh: Array) -> Array:
    return sh[:, 1:].reshape(len(sh), -1).astype(np.float64)


def _squared_distances(points: Array, centres: Array) -> Array:
    apart = points[:, None].astype(np.float64) - centres.astype(np.float64)
    return np.asarray(np.einsum("ncd,ncd->nc", apart, apart))
