"""A palette for the harmonics beyond the DC: at most 65,536 vectors of 9, 24 or 45 values that stand for all rows.

Plain K-means costs n · K · 3(k−1) products a round: 3 · 10¹² for a million rows of degree 3. Three observations make it
cheap, at an error within a percent of exact K-means (docs/reference/formats/sog.md):

- A palette of K vectors has log₂ K bits. By reverse water-filling (Cover & Thomas 2006, §10.3.3) they all go to the principal
  axes whose variance is above a level θ with Σ ½ log₂(λ/θ) = log₂ K: a dozen of 45 axes in trained scenes. Distances are taken
  in these; the entries are means in all dimensions.
- K-means in two levels: coarse groups, and K-means inside each, with a share of the entries that grows with the group's error.
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
    parts: Parts, weights: Float32[Array, "n"], num_entries: int, *, iterations: int = 3, threads: int = 0
) -> Palette:
    """The palette of at most ``num_entries`` entries for the harmonics beyond the DC, weighted.

    The rows are gone through three times, part by part; of each are kept its weight, its coordinates along the dozen of axes, and
    numbers of groups.
    """
    with task("palette of harmonics", 5.0) as advance:
        exact, sample = _look(parts, len(weights), num_entries)
        if exact is not None:
            return exact
        advance(1.0)
        points = _points(parts, weights, sample, num_entries, threads)
        num_groups = int(np.clip(round(num_entries / _ENTRIES_PER_GROUP), 1, 2048))
        coarse = _coarse_centres(points, weights, num_groups, threads)
        near = kernel.nearest_few(points, coarse, _NEAR, threads=threads)
        advance(1.0)
        group = np.ascontiguousarray(near[:, 0])
        first = _first_entries(points, weights, coarse, group, min(num_entries, len(points)))
        centres = kernel.split_groups(points, weights, group, first, iterations=iterations, threads=threads)
        advance(1.0)
        labels = kernel.nearest_in_groups(points, centres, first, near, threads=threads)
        del points, near, group
        advance(1.0)
        entries = _means(parts, weights, labels, len(centres))
        advance(1.0)
    return Palette(entries, labels)


def _look(parts: Parts, num_rows: int, num_entries: int) -> tuple[Palette | None, Array]:
    """The palette of all different vectors, if they are few enough; and a sample of the rows beyond the DC, flat."""
    every = -(-num_rows // _SAMPLE)
    distinct, labels, samples, begin = None, np.empty(num_rows, np.int32), [], 0
    few = True
    for sh in parts():
        distinct = distinct or kernel.DistinctRows(3 * (sh.shape[1] - 1), num_entries)
        if few:
            found = distinct.number(sh)
            few = found is not None
            labels[begin : begin + len(sh)] = found if found is not None else 0
        samples.append(sh[-begin % every :: every, 1:].reshape(-1, 3 * (sh.shape[1] - 1)).copy())
        begin += len(sh)
    assert distinct is not None
    exact = Palette(distinct.entries.reshape(-1, distinct.entries.shape[1] // 3, 3), labels) if few else None
    return exact, np.concatenate(samples)


def _points(parts: Parts, weights: Array, sample: Array, num_entries: int, threads: int) -> Array:
    """The rows along the principal axes that receive bits."""
    x, w = sample.astype(np.float64), weights[:: -(-len(weights) // _SAMPLE)].astype(np.float64)
    w = w / w.sum()
    origin = np.einsum("n,nj->j", w, x)  # einsum, not a matrix product: its sums do not depend on threads
    x -= origin
    variances, axes = np.linalg.eigh(np.einsum("ni,nj->ij", x * w[:, None], x))
    count = max(1, int((variances > _water_level(variances, np.log2(num_entries)) / 2).sum()))
    points, begin = np.empty((len(weights), count), np.float32), 0
    for sh in parts():
        points[begin : begin + len(sh)] = kernel.onto_axes(sh, origin, axes[:, ::-1][:, :count], threads=threads)
        begin += len(sh)
    return points


def _means(parts: Parts, weights: Array, labels: Array, num_entries: int) -> Array:
    """Weighted mean of the rows of each label; zero where no row has it."""
    sums, begin = np.zeros((0, 0)), 0
    for sh in parts():
        if not sums.size:
            sums = np.zeros((num_entries, 3 * (sh.shape[1] - 1) + 1))
        rows = slice(begin, begin + len(sh))
        kernel.add_to_sums(sh, weights[rows], labels[rows], sums)
        begin += len(sh)
    total = sums[:, -1:]
    sums[:, :-1] /= np.where(total > 0, total, 1)
    return sums[:, :-1].astype(np.float32).reshape(num_entries, -1, 3)


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
