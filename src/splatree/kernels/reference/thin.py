"""Radius thinning: the sequential greedy, as it is defined.

Rows in the order of falling importance, ties by row: a row is a *representative* iff no earlier representative lies within r.
Each other row joins its nearest earlier representative, ties by priority. Distances are compared squared, in float64:

    d² = |x_i − x_j|² + r² |c_i − c_j|² / ρ²,   within iff d² ≤ r²

a ball in position and colour, so that Gaussians of different colour stay apart (ρ = ∞ leaves colour out). The
representatives are the lexicographically first maximal independent set of the graph of neighbours: unique, whatever order or
number of threads finds it.

With a `MergeLimit`, two rows within r are neighbours only if merging them changes the picture by at most ``most``
(kernels/reference/pairs.py), or if leaving both out can do no more, 2 (e_i + e_j) ≤ ``most`` with the energy e of what each
shows: a row joins no representative that it would spoil, and may become one itself. The energies decide alone where α_m is
raised to 1e-4: large, very faint Gaussians, which nobody sees, join.

`certain` decides the same for a part of a scene, of whose *open* rows neighbours may be missing. A row is unknown if it is open,
or if no earlier neighbour is a representative and one is unknown. A member's representative is certain if it is nearer than
each unknown earlier neighbour. The whole scene decides what is certain in the same way, whatever lies outside of the part: a row
that is not open has all of its neighbours here, and the rules are those above.

Cost: O(n · g).
"""

import numpy as np

from splatree.kernels.reference.pairs import energies, pair_costs
from splatree.scene.thinning import Groups, MergeLimit
from splatree.shapes import Array, Bool, Float32, Int32

__all__ = ["certain", "group", "thin"]


def thin(
    means: Float32[Array, "n 3"],
    colors: Float32[Array, "n 3"],
    importance: Float32[Array, "n"],
    *,
    radius: float,
    color_radius: float,
    limit: MergeLimit | None = None,
) -> Groups:
    """Groups of rows within ``radius`` of their representative."""
    whole = np.zeros(len(means), bool)
    return group(certain(means, colors, importance, whole, radius=radius, color_radius=color_radius, limit=limit))


def certain(
    means: Float32[Array, "n 3"],
    colors: Float32[Array, "n 3"],
    importance: Float32[Array, "n"],
    is_open: Bool[Array, "n"],
    *,
    radius: float,
    color_radius: float,
    limit: MergeLimit | None = None,
) -> Int32[Array, "n"]:
    """The representative of each row of a part of a scene, −1 where it depends on rows that the part may lack."""
    x, c = means.astype(np.float64), colors.astype(np.float64)
    radius2 = radius * radius
    factor = 0.0 if np.isinf(color_radius) else radius2 / (color_radius * color_radius)
    n = len(x)
    representative_from_row = np.arange(n, dtype=np.int32)
    is_unknown = np.zeros(n, bool)
    shown = None if limit is None else energies(limit.gaussians, limit.visibilities, dilation=0.0)
    kept: list[int] = []  # representatives and unknown rows, the earliest first
    for i in np.lexsort((np.arange(n), -importance.astype(np.float64))):
        dx, dc = x[kept] - x[i], c[kept] - c[i]
        # Summed in this order, which the fast kernel keeps: both round alike.
        distances2 = (dx[:, 0] * dx[:, 0] + dx[:, 1] * dx[:, 1] + dx[:, 2] * dx[:, 2]) + factor * (
            dc[:, 0] * dc[:, 0] + dc[:, 1] * dc[:, 1] + dc[:, 2] * dc[:, 2]
        )
        within = distances2 <= radius2
        if limit is not None and shown is not None:
            near = np.flatnonzero(within)
            others = np.asarray(kept, int)[near]
            changes_little = 2 * (shown[i] + shown[others]) <= limit.most
            within[near] = changes_little | (_costs(limit, i, others) <= limit.most)
        if is_open[i] or not np.any(within & ~is_unknown[kept]):
            is_unknown[i] = is_open[i] or np.any(within)
            kept.append(int(i))
        else:
            nearest = int(np.argmin(np.where(within, distances2, np.inf)))  # the first of equals is the earliest
            representative_from_row[i] = kept[nearest]
    representative_from_row[is_unknown | is_unknown[representative_from_row]] = -1
    return representative_from_row


def _costs(limit: MergeLimit, row: int, others: Array) -> Array:
    first = np.full(len(others), row)
    return pair_costs(limit.gaussians, limit.weights, first, others, limit.visibilities, dilation=0.0)[0]


def group(representative_from_row: Array, *, rounds: int = 0, num_visited: int = 0) -> Groups:
    """The groups of rows that share a representative, which is one of them."""
    representatives, group_from_row = np.unique(representative_from_row, return_inverse=True)
    start = np.searchsorted(np.sort(group_from_row), np.arange(len(representatives) + 1))
    return Groups(
        representatives=representatives.astype(np.int32),
        group_from_row=group_from_row.astype(np.int32),
        start=start.astype(np.int64),
        rows=np.argsort(group_from_row, kind="stable").astype(np.int32),
        rounds=rounds,
        num_visited=num_visited,
    )
