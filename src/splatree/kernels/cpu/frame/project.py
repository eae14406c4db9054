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

__all__ = ["SplatRoom", "gathered", "project", "project_into"]


class SplatRoom:
    """Space for the splats of a frame, not written yet."""

    def __init__(self, num_splats: int) -> None:
        self.num_splats = num_splats
        self.rows, self.order = np.empty(num_splats, np.int32), np.empty(num_splats, np.int32)
        self.depths = np.empty(num_splats, np.float32)
        self.records = _empty_records(num_splats)


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
    return project_into(SplatRoom(len(rows)), gaussians, ids, rows, view, curves=curves, threads=threads)


def project_into(
    room: SplatRoom,
    gaussians: Gaussians,
    ids: UInt32[Array, "n"] | None,
    rows: Int32[Array, "v"],
    view: View,
    *,
    curves: Float32[Array, "n 4"] | None = None,
    threads: int = 0,
) -> Splats:
    """The same, in a room for at least as many splats as there are rows."""
    if len(rows) and not (rows.min() >= 0 and rows.max() < len(gaussians)):
        raise InputError(f"rows: found {rows.min()} to {rows.max()}, wanted 0 to {len(gaussians) - 1}")
    followed = curves if view.mode == "classic" else None
    out = {"rows": room.rows, "records": room.records, "depths": room.depths}
    num_splats = _core.project_rows(gaussians, followed, rows, pack_view(view), view, pack_square(view), out, threads)
    splats = Splats(room.rows[:num_splats], room.records[:num_splats], room.order[:num_splats])
    _core.order_splats(room.depths, splats.rows, ids, splats.order, threads)
    return splats


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
