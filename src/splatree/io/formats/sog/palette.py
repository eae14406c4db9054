"""A palette for the harmonics beyond the DC: at most 65,536 vectors of 9, 24 or 45 values that stand for all rows.

Plain K-means costs n · K · 3(k−1) products a round: 3 · 10¹² for a million rows of degree 3. Three observations make it
cheap, at an error within a percent of exact K-means (docs/reference/formats/sog.md):

- A palette of K vectors has log₂ K bits. By reverse water-filling (Cover & Thomas 2006, §10.3.3) they all go to the principal
  axes whose variance is above a level θ with Σ ½ log₂(λ/θ) = log₂ K: a dozen of 45 axes in trained scenes. Distances are taken
  in these; the entries are means in all dimensions.
- K-means in two levels: coarse groups, and K-means inside each, with a share of the entries that grows with the group's error.
- In scenes of many rows, groups and entries are found from some of them, 32 for each of the most entries; all rows are then given
  the nearest entry, and an entry is the mean of all its rows.
- A row is then nearest to an entry of one of a few near groups, not only of its own (as the cells of an inverted file are
  probed: Jégou 2011, "Product quantization for nearest neighbor search").

Rows weigh what the picture sees of them. Scenes whose vectors are few (read from a palette before) are kept exactly.
Everything is deterministic: samples are strides, sums run in the order of rows.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from splatree.kernels.cpu.codec import palette as kernel
from splatree.progress import task
from splatree.shapes import Array, Float32, Int32, check_fields

__all__ = ["Palette", "Parts", "find_palette"]

_SAMPLE = 1 << 14
"""Rows from which the principal axes are found: the error of a variance is 1 %."""

_ENTRIES_PER_GROUP = 96
"""Entries of a group in the middle: the coarse search and the search inside then cost about the same."""

_COARSE_SAMPLE = 64
"""Rows for each group from which the coarse centres are found."""

_COARSE_ROUNDS = 8
_NEAR = 4
"""Groups that are searched for a row; with one the error is 6 % larger, with eight 1 % less."""

_SHARE = 0.8
"""Entries of a group go with its error to this power: d / (d + 2) for d = 8 dimensions (Gersho 1979)."""


_ROWS_AT_ONCE = 1 << 14

_CLUSTERED = 1 << 21
"""Rows from which the entries are found: where they are a fourth of all, the error is 1 % larger, and K-means takes a fourth."""

Parts = Callable[[], Iterable[Float32[Array, "m k 3"]]]
"""Starts again with the harmonics of the first rows; a part is valid until the next is asked for."""


@dataclass(frozen=True, eq=False)
class Palette:
    """Vectors that stand for all rows."""

    entries: Float32[Array, "p j 3"]
    """Harmonics beyond the DC, coefficient by coefficient with RGB inside."""
    labels: Int32[Array, "n"]
    """The entry of each row."""

    def __post_init__(self) -> None:
        check_fields(self)


def find_palette(
    parts: Parts,
    weights: Float32[Array, "n"],
    num_entries: int,
    *,
    iterations: int = 3,
    threads: int = 0,
    labels: Int32[Array, "n"] | None = None,
) -> Palette:
    """The palette of at most ``num_entries`` entries for the harmonics beyond the DC, weighted.

    The rows are gone through three times, part by part; of each are kept its weight and its label, which go into ``labels`` if
    these are given, and of `_CLUSTERED` of them the coordinates along the dozen of axes.
    """
    labels = np.empty(len(weights), np.int32) if labels is None else labels
    with task("palette of harmonics", 4.0) as advance:
        entries, sample = _look(parts, labels, num_entries)
        if entries is not None:
            return Palette(entries, labels)
        advance(1.0)
        every = -(-len(weights) // _CLUSTERED)
        axes = _axes(sample, weights, num_entries)
        some = np.ascontiguousarray(weights[::every])
        points = axes.points(parts, len(some), every, threads)
        num_groups = int(np.clip(round(num_entries / _ENTRIES_PER_GROUP), 1, 2048))
        coarse = _coarse_centres(points, some, num_groups, threads)
        group = np.ascontiguousarray(kernel.nearest_few(points, coarse, 1, threads=threads)[:, 0])
        advance(1.0)
        first = _first_entries(points, some, coarse, group, min(num_entries, len(points)))
        centres = kernel.split_groups(points, some, group, first, iterations=iterations, threads=threads)
        del points, group
        advance(1.0)
        sums, begin = np.zeros((len(centres), sample.shape[1] + 1)), 0
        for sh in parts():
            rows = slice(begin, begin + len(sh))
            own = axes.of(sh, threads)
            near = kernel.nearest_few(own, coarse, _NEAR, threads=threads)
            labels[rows] = kernel.nearest_in_groups(own, centres, first, near, threads=threads)
            kernel.add_to_sums(sh, weights[rows], labels[rows], sums)
            begin += len(sh)
        advance(1.0)
    return Palette(_means(sums), labels)


def _look(parts: Parts, labels: Array, num_entries: int) -> tuple[Array | None, Array]:
    """All different vectors, if they are few enough, with ``labels`` filled; and a sample of the rows beyond the DC, flat."""
    every = -(-len(labels) // _SAMPLE)
    distinct, samples, begin, few = None, [], 0, True
    for sh in parts():
        distinct = distinct or kernel.DistinctRows(3 * (sh.shape[1] - 1), num_entries)
        if few:
            found = distinct.number(sh)
            few = found is not None
            labels[begin : begin + len(sh)] = found if found is not None else 0
        samples.append(sh[-begin % every :: every, 1:].reshape(-1, 3 * (sh.shape[1] - 1)).copy())
        begin += len(sh)
    assert distinct is not None
    entries = distinct.entries.reshape(-1, samples[0].shape[1] // 3, 3) if few else None
    return entries, np.concatenate(samples)


@dataclass(frozen=True, eq=False)
class _Axes:
    """The principal axes that receive bits."""

    origin: Array  # [j]
    axes: Array  # [j d]

    def of(self, sh: Array, threads: int) -> Array:
        """Rows along the axes."""
        return kernel.onto_axes(sh, self.origin, self.axes, threads=threads)

    def points(self, parts: Parts, count: int, every: int, threads: int) -> Array:
        """Each ``every``-th row along the axes, ``count`` of them."""
        points, begin, done = np.empty((count, self.axes.shape[1]), np.float32), 0, 0
        for sh in parts():
            own = np.ascontiguousarray(sh[-begin % every :: every])
            points[done : done + len(own)] = self.of(own, threads)
            begin, done = begin + len(sh), done + len(own)
        return points


def _axes(sample: Array, weights: Array, num_entries: int) -> _Axes:
    x, w = sample.astype(np.float64), weights[:: -(-len(weights) // _SAMPLE)].astype(np.float64)
    w = w / w.sum()
    origin = np.einsum("n,nj->j", w, x)  # einsum, not a matrix product: its sums do not depend on threads
    x -= origin
    variances, axes = np.linalg.eigh(np.einsum("ni,nj->ij", x * w[:, None], x))
    count = max(1, int((variances > _water_level(variances, np.log2(num_entries)) / 2).sum()))
    return _Axes(origin, axes[:, ::-1][:, :count])


def _means(sums: Array) -> Array:
    """Weighted means of sums whose last column are the weights; zero where there are none."""
    total = sums[:, -1:]
    means: Array = (sums[:, :-1] / np.where(total > 0, total, 1)).astype(np.float32)
    return means.reshape(len(sums), -1, 3)


def _water_level(variances: Array, bits: float) -> float:
    """θ with Σ max(0, ½ log₂(λ/θ)) = bits."""
    logs = np.sort(np.log2(np.maximum(variances, 1e-30)))[::-1]
    # With the m largest above the level it is (Σ log₂ λ − 2 bits) / m; the right m is the one that gives the highest.
    m = np.arange(1, len(logs) + 1)
    return float(2.0 ** np.max((np.cumsum(logs) - 2 * bits) / m))


def _coarse_centres(points: Array, weights: Array, num_groups: int, threads: int) -> Array:
    every = -(-len(points) // (num_groups * _COARSE_SAMPLE))
    sample, w = np.ascontiguousarray(points[::every]), np.ascontiguousarray(weights[::every])
    centres = np.ascontiguousarray(sample[:: -(-len(sample) // num_groups)])
    for _ in range(_COARSE_ROUNDS):
        labels = np.ascontiguousarray(kernel.nearest_few(sample, centres, 1, threads=threads)[:, 0])
        means = kernel.point_means(sample, w, labels, len(centres), threads=threads)
        used = np.bincount(labels, minlength=len(centres)) > 0
        centres = np.where(used[:, None], means, centres)
    return centres


def _first_entries(points: Array, weights: Array, coarse: Array, group: Array, num_entries: int) -> Array:
    """Entries of each group, as the running sum that begins with 0."""
    counts = np.bincount(group, minlength=len(coarse))
    errors = np.zeros(len(coarse))
    for begin in range(0, len(points), _ROWS_AT_ONCE):
        rows = slice(begin, begin + _ROWS_AT_ONCE)
        apart = points[rows] - coarse[group[rows]]
        errors += np.bincount(group[rows], weights[rows] * np.einsum("nd,nd->n", apart, apart), minlength=len(coarse))
    share = np.maximum(errors, 1e-300) ** _SHARE * (counts > 0)
    entries = np.minimum(counts, 1)
    while (left := num_entries - int(entries.sum())) > 0:
        room = counts - entries
        wanted = np.where(room > 0, share, 0.0)
        more = np.minimum(room, np.floor(wanted / wanted.sum() * left).astype(np.int64))
        if not more.any():  # fewer than one each: the largest shares
            more[np.argsort(-wanted, kind="stable")[:left]] = 1
            more = np.minimum(more, room)
        entries = entries + more
    return np.concatenate([[0], np.cumsum(entries)]).astype(np.int64)
