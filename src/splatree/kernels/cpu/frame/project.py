"""Project Gaussians to splats: glue over project.cpp and order.cpp; kernels/reference/project.py is the definition."""

from collections.abc import Iterable

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame.view import pack_square, pack_view
from splatree.scene.frame import Splats
from splatree.scene.gaussians import Gaussians
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, UInt32

__all__ = ["gathered", "project"]


def project(
    gaussians: Gaussians,
    ids: UInt32[Array, "n"] | None,
    rows: Int32[Array, "v"],
    view: View,
    *,
    curves: Float32[Array, "n 4"] | None = None,
    threads: int = 0,
) -> Splats:
    """Splats of the rows that touch the image."""
    if len(rows) and not (rows.min() >= 0 and rows.max() < len(gaussians)):
        raise InputError(f"rows: found {rows.min()} to {rows.max()}, wanted 0 to {len(gaussians) - 1}")
    out_rows, depths = np.empty(len(rows), np.int32), np.empty(len(rows), np.float32)
    records = _empty_records(len(rows))
    followed = curves if view.mode == "classic" else None
    out = {"rows": out_rows, "records": records, "depths": depths}
    num_splats = _core.project_rows(gaussians, followed, rows, pack_view(view), view, pack_square(view), out, threads)
    out_rows, records = out_rows[:num_splats], records[:num_splats]
    order = np.empty(num_splats, np.int32)
    _core.order_splats(depths, out_rows, ids, order, threads)
    return Splats(out_rows, records, order)


def gathered(
    parts: Iterable[tuple[Array, Splats]], rows: Int32[Array, "v"], ids: UInt32[Array, "v"], *, threads: int = 0
) -> Splats:
    """The splats of a selection that was projected in parts: those of `project` of all of it at once.

    Args:
        parts: of each part, its splats, and which of the selected rows each row is that they are numbered by.
        rows: the selected rows.
        ids: their identities.
        threads: threads to use; 0: all.
    """
    records, is_seen = _empty_records(len(rows)), np.zeros(len(rows), bool)
    for places, splats in parts:
        seen = places[splats.rows]
        records[seen], is_seen[seen] = splats.records, True
    kept = np.flatnonzero(is_seen)
    of_splats = _empty_records(len(kept))
    np.take(records, kept, axis=0, out=of_splats)
    order = np.empty(len(kept), np.int32)
    numbers = np.arange(len(kept), dtype=np.int32)
    _core.order_splats(of_splats[:, 10].copy(), numbers, ids[kept], order, threads)
    return Splats(rows[kept], of_splats, order)


def _empty_records(num_rows: int) -> Float32[Array, "v 16"]:
    """Space for records that starts at a cache line; pages that are never written cost nothing."""
    space = np.empty(16 * num_rows + 16, np.float32)
    skip = -space.ctypes.data % 64 // 4
    return space[skip : skip + 16 * num_rows].reshape(num_rows, 16)
