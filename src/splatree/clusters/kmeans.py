"""K-means of points in space (Lloyd 1982): exact, deterministic, and cheap for many clusters.

    label_i = argmin_j |p_i − c_j|²,   c_j = mean of the points with label j,   and again

from centres that are points drawn at random. A centre that no point is nearest to is put on the point that is farthest from its
own. Better seeds and more iterations hardly matter for culling: ten from random points exclude within 0.1 % of what 25 do.

Cost: one step for 6 M points and 32,768 centres takes 0.6 CPU-seconds, if the points are in an order that keeps neighbours
together (`maths.morton`): the kernel then finds the few candidates of 64 points at once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from splatree.errors import InputError
from splatree.kernels.devices import DeviceName, feature_of
from splatree.progress import task
from splatree.shapes import Array, Float32, Float64, Int32, Int64, check_fields

__all__ = ["ROWS_AT_ONCE", "KMeans", "Zeros", "kmeans"]

ROWS_AT_ONCE = 1 << 20
"""Points that are looked at together where all of them may lie in a file."""

Zeros = Callable[[tuple[int, ...], type], Array]
"""Makes an array of zeros, given its shape and type: `numpy.zeros`, or one that is mapped from a file."""

LEAST_GAIN = 1e-4
"""An iteration that lowers the inertia by a smaller share is the last."""


@dataclass(frozen=True, eq=False)
class KMeans:
    """Points in clusters."""

    labels: Int32[Array, "n"]
    """Cluster of each point."""
    centers: Float64[Array, "c 3"]
    """Mean of the points of each cluster; the place of the centre where there are none."""
    inertia: tuple[float, ...]
    """Sum of the squared distances to the nearest centre, before the first iteration and after each."""

    def __post_init__(self) -> None:
        check_fields(self)


def kmeans(
    points: Float32[Array, "n 3"],
    num_clusters: int,
    *,
    iterations: int = 10,
    rng: np.random.Generator | None = None,
    threads: int = 0,
    device: DeviceName = "cpu",
    zeros: Zeros = np.zeros,
) -> KMeans:
    """Put points into clusters of neighbours.

    Args:
        points: finite; fast if neighbours in the list are near in space.
        num_clusters: at most the number of points. Where points coincide, clusters may stay empty.
        iterations: at most this many, fewer once they gain less than 1e-4 of the inertia.
        rng: draws the first centres; None: always the same ones.
        threads: 0 means all there are; the result has the same bits for any number.
        device: where the steps are taken. Two runs on a GPU give the same bits too; from the processor's they differ by
            rounding, and so may the few points halfway between two centres.
        zeros: makes the arrays that have a row for each point, 20 bytes together; they may lie in files.

    Raises:
        InputError: more clusters than points, or less than one, or points that are not finite.
        DeviceError: there is no GPU, or it has failed.
    """
    if not 1 <= num_clusters <= len(points):
        raise InputError(f"kmeans: found {num_clusters} clusters for {len(points)} points, wanted 1 to {len(points)}")
    if not np.isfinite(points.sum(dtype=np.float64)):  # a single pass that makes no copy
        row = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InputError(f"kmeans: found {points[row]} at row {row}, wanted finite points")
    # Around the middle, so that map coordinates keep their precision in float32.
    middle = (points.min(axis=0).astype(np.float64) + points.max(axis=0)) / 2
    shifted = zeros(points.shape, np.float32)
    for begin in range(0, len(points), ROWS_AT_ONCE):
        shifted[begin : begin + ROWS_AT_ONCE] = points[begin : begin + ROWS_AT_ONCE] - middle
    rng = rng or np.random.default_rng(0)
    centers = shifted[np.sort(rng.choice(len(points), num_clusters, replace=False))]
    step = _steps(device, shifted, threads, zeros)
    found = step(centers)
    inertia = [found.inertia]
    with task("K-means", float(iterations)) as advance:
        for _ in range(iterations):
            centers = _means(shifted, found)
            found = step(centers)
            inertia.append(found.inertia)
            advance(1.0)
            if inertia[-2] - inertia[-1] < LEAST_GAIN * inertia[-2]:
                break
    means = np.where(found.counts[:, None] > 0, found.sums / np.maximum(found.counts, 1)[:, None], centers)
    return KMeans(found.labels, means + middle, tuple(inertia))


class Step(Protocol):
    """What a step has found, as `Assignment` has it."""

    @property
    def labels(self) -> Int32[Array, "n"]: ...
    @property
    def squared_distances(self) -> Float32[Array, "n"]: ...
    @property
    def sums(self) -> Float64[Array, "c 3"]: ...
    @property
    def counts(self) -> Int64[Array, "c"]: ...
    @property
    def inertia(self) -> float: ...


def _steps(device: DeviceName, points: Float32[Array, "n 3"], threads: int, zeros: Zeros) -> Callable[[Array], Step]:
    """What assigns the points to centres; a step may overwrite what the one before has found."""
    steps = feature_of(device, "kmeans_steps")
    if steps is None:
        raise InputError(f"kmeans: found device {device!r}, which has no steps of K-means; wanted another device")
    found: Callable[[Array], Step] = steps(points, threads=threads, zeros=zeros)
    return found


def _means(points: Array, found: Step) -> Float32[Array, "c 3"]:
    """The mean of each centre's points; a centre without points moves to the point that is farthest from its own."""
    empty = np.flatnonzero(found.counts == 0)
    moved = (found.sums / np.maximum(found.counts, 1)[:, None]).astype(np.float32)
    if len(empty):
        moved[empty] = points[_farthest(found.squared_distances, len(empty))]
    return np.asarray(moved)


def _farthest(distances: Float32[Array, "n"], count: int) -> Int64[Array, "count"]:
    """Rows of the largest distances, the largest first; of equal ones the first rows."""
    rows, step = np.empty(0, np.int64), max(ROWS_AT_ONCE, count)
    for begin in range(0, len(distances), step):
        block = distances[begin : begin + step]
        least = np.partition(block, -count)[-count] if len(block) > count else -np.inf
        candidates = np.concatenate([rows, begin + np.flatnonzero(block >= least)])
        rows = candidates[np.argsort(-distances[candidates], kind="stable")[:count]]
    return rows
