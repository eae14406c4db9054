"""Gaussians in chunks of 256, each value in a few bits of its chunk's range, as ``reference/packed.py``, compiled."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int64, UInt8, UInt32

__all__ = ["CHUNK", "pack", "unpack"]

CHUNK = 256
"""Gaussians that share a range."""


def pack(
    gaussians: Gaussians, order: Int64[Array, "n"], *, threads: int = 0
) -> tuple[Float32[Array, "c 18"], UInt32[Array, "n 4"], UInt8[Array, "n r"]]:
    """Bounds of the chunks, vertices and harmonics of the rows in ``order``."""
    g, n = gaussians, len(order)
    bounds = np.empty((-(-n // CHUNK), 18), np.float32)
    vertices, rest = np.empty((n, 4), np.uint32), np.empty((n, 3 * (g.sh.shape[1] - 1)), np.uint8)
    _core.pack_chunks(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh, order, bounds, vertices, rest, threads)
    return bounds, vertices, rest


def unpack(
    bounds: Float32[Array, "c 18"],
    vertices: UInt32[Array, "n 4"],
    rest: UInt8[Array, "n r"],
    logit_table: Float32[Array, "256"],
    columns: tuple[Array, Array, Array, Array, Array],
    *,
    threads: int = 0,
) -> None:
    """Fill the ``columns`` of a `Gaussians`; ``logit_table`` has the logit of each code of opacity."""
    means, quats, log_scales, logits, sh = columns
    n = len(vertices)
    assert len(bounds) == -(-n // CHUNK) and rest.shape == (n, 3 * (sh.shape[1] - 1)) and logit_table.shape == (256,)
    assert all(len(column) == n for column in columns)
    _core.unpack_chunks(bounds, vertices, rest, logit_table, means, quats, log_scales, logits, sh, threads)
