"""Radius thinning on the processor: exactly the groups of ``reference/thin.py``, by parallel rounds over a sorted grid."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.thinning import Groups, MergeLimit
from splatree.shapes import Array, Bool, Float32, Float64, Int32, Int64

__all__ = ["certain", "count_representatives", "group", "nearest_distances", "rows_by_group", "thin"]


def thin(
    means: Float32[Array, "n 3"],
    colors: Float32[Array, "n 3"],
    importance: Float32[Array, "n"],
    *,
    radius: float,
    color_radius: float,
    limit: MergeLimit | None = None,
    threads: int = 0,
) -> Groups:
    """Groups of rows within ``radius`` of their representative."""
    representative_from_row = np.empty(len(means), np.int32)
    rounds, visited = _core.thin(
        means, colors, importance, radius, color_radius, None, True, limit, representative_from_row, threads
    )
    return group(representative_from_row, rounds=rounds, num_visited=visited)


def certain(
    means: Float32[Array, "n 3"],
    colors: Float32[Array, "n 3"],
    importance: Float32[Array, "n"],
    is_open: Bool[Array, "n"],
    *,
    radius: float,
    color_radius: float,
    limit: MergeLimit | None = None,
    threads: int = 0,
) -> Int32[Array, "n"]:
    """The representative of each row of a part of a scene, −1 where it depends on rows that the part may lack.

    ``is_open`` rows may have neighbours within ``radius`` that are not here.
    """
    representative_from_row = np.empty(len(means), np.int32)
    _core.thin(
        *(means, colors, importance, radius, color_radius, is_open.view(np.uint8), True, limit),
        representative_from_row,
        threads,
    )
    return representative_from_row


def count_representatives(
    means: Float32[Array, "n 3"],
    colors: Float32[Array, "n 3"],
    importance: Float32[Array, "n"],
    *,
    radius: float,
    color_radius: float,
    threads: int = 0,
) -> int:
    """Number of groups that `thin` would find, without looking for the members'."""
    representative_from_row = np.empty(len(means), np.int32)
    _core.thin(means, colors, importance, radius, color_radius, None, False, None, representative_from_row, threads)
    return int(np.count_nonzero(representative_from_row >= 0))


def nearest_distances(
    means: Float32[Array, "n 3"], queries: Int32[Array, "q"], *, edge: float, threads: int = 0
) -> Float64[Array, "q"]:
    """Distance from each row in ``queries`` to its nearest other row if that is at most ``edge``, else infinity."""
    distances = np.empty(len(queries))
    if len(queries):
        _core.nearest_distances(means, queries, edge, distances, threads)
    return distances


def group(representative_from_row: Int32[Array, "n"], *, rounds: int = 0, num_visited: int = 0) -> Groups:
    """The groups of rows that share a representative, which is one of them."""
    n = len(representative_from_row)
    is_representative = representative_from_row == np.arange(n, dtype=np.int32)
    representatives = np.flatnonzero(is_representative).astype(np.int32)
    group_from_representative = np.cumsum(is_representative, dtype=np.int32) - np.int32(1)
    group_from_row = group_from_representative[representative_from_row]
    start, rows = rows_by_group(group_from_row, len(representatives))
    return Groups(representatives, group_from_row, start, rows, rounds=rounds, num_visited=num_visited)


def rows_by_group(group_from_row: Int32[Array, "n"], num_groups: int) -> tuple[Int64[Array, "g+1"], Int32[Array, "n"]]:
    """Where the rows of each group begin in the list of all rows by group, and that list, rows ascending inside each."""
    start, rows = np.empty(num_groups + 1, np.int64), np.empty(len(group_from_row), np.int32)
    _core.group_rows(group_from_row, num_groups, start, rows)
    return start, rows
