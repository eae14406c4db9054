"""Steps from what a page holds to another cut, over a slow line: each is a cut, and brings no more nodes than the line carries.

Rows are in depth-first preorder. So the nodes of a fine cut below a node of a coarse cut of the same view are those from it up to
the next node of the coarse cut. A step replaces some of the coarse nodes by what is below them; every part of the scene is drawn
once all the while.

At the border of the picture the coarse cut may leave out a node that the fine cut has a part of in view. Such parts count with
the coarse node before them.
"""

import numpy as np

from splatree.shapes import Array, Bool, Int32

__all__ = ["advanced", "mixed"]


def mixed(coarse: Int32[Array, "c"], fine: Int32[Array, "v"], is_held: Bool[Array, "v"]) -> Int32[Array, "m"]:
    """Rows of a cut between two of one view, ascending: fine where all fine rows are held, which cost nothing, else coarse."""
    bounds, num_missing = _groups(coarse, fine, is_held)
    return _replaced(coarse, fine, bounds, num_missing == 0, is_held[: bounds[0]])


def advanced(
    held: Int32[Array, "c"], fine: Int32[Array, "v"], is_held: Bool[Array, "v"], order: Int32[Array, "c"], room: float
) -> Int32[Array, "m"]:
    """Rows of the cut that follows ``held`` on the way to a finer one of the same view, ascending.

    Nodes are replaced in this ``order`` of their places as long as there is ``room`` for new rows, and at least one.
    """
    bounds, num_missing = _groups(held, fine, is_held)
    order = order[num_missing[order] > 0]
    num_taken = max(1, int(np.searchsorted(np.cumsum(num_missing[order]), room, side="right")))
    if num_taken >= len(order):
        return fine
    is_fine = num_missing == 0
    is_fine[order[:num_taken]] = True
    return _replaced(held, fine, bounds, is_fine, is_held[: bounds[0]])


def _groups(coarse: Array, fine: Array, is_held: Array) -> tuple[Array, Array]:
    """Where the fine rows of each coarse one begin, and one past the last, "c+1"; how many of them are not held "c"."""
    bounds = np.append(np.searchsorted(fine, coarse), len(fine))
    return bounds, np.diff(np.concatenate([[0], np.cumsum(~is_held)])[bounds])


def _replaced(coarse: Array, fine: Array, bounds: Array, is_fine: Array, takes_before: Array) -> Array:
    """The coarse rows, or what is below them; of the fine rows before the first coarse one, those marked."""
    takes = np.concatenate([takes_before, np.repeat(is_fine, np.diff(bounds))])
    return np.sort(np.concatenate([fine[takes], coarse[~is_fine]]))
