"""Gaussians in chunks of 256, each value in a few bits of its chunk's range: what the fast kernels must give.

A chunk keeps the least and largest of each coordinate, log-scale (held within ±20) and colour ``½ + C0 dc``. A value is its
share of that range, rounded to the nearest of 2ᵇ steps: 11, 10, 11 bits of x, y, z and of the scales, 8 of each colour; opacity
is 8 bits of 0 to 1. A rotation is its smallest three components in the order w, x, y, z, ``½ + √½ q`` in 10 bits each, below the
place of the largest, which is made positive. Harmonics are bytes ``⌊256 (½ + sh / 8)⌋``, channel by channel; their codes stand
for the middles of their steps, but for the two ends.
"""

import numpy as np

from splatree.constants import SH_C0
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Int64, UInt8, UInt32

__all__ = ["CHUNK", "pack", "unpack"]

CHUNK = 256
"""Gaussians that share a range."""

LOG_SCALE_MAX = 20


def pack(
    gaussians: Gaussians, order: Int64[Array, "n"], *, threads: int = 0
) -> tuple[Float32[Array, "c 18"], UInt32[Array, "n 4"], UInt8[Array, "n r"]]:
    """Bounds of the chunks, vertices and harmonics of the rows in ``order``."""
    g = gaussians.take(order)
    bounds = np.zeros((-(-len(g) // CHUNK), 18), np.float32)
    vertices = np.zeros((len(g), 4), np.uint32)
    for chunk in range(len(bounds)):
        rows = slice(chunk * CHUNK, (chunk + 1) * CHUNK)
        colors = (g.sh[rows, 0] * np.float32(SH_C0) + np.float32(0.5)).astype(np.float64)
        codes = []
        for kind, (values, limit) in enumerate(((g.means, np.inf), (g.log_scales, LOG_SCALE_MAX), (colors, np.inf))):
            values = (values if kind == 2 else values[rows]).astype(np.float64)
            low, high = (np.clip(f(values, axis=0), -limit, limit) for f in (np.min, np.max))
            bounds[chunk, 6 * kind : 6 * kind + 6] = (*low, *high)
            most = 255 if kind == 2 else np.array([2047, 1023, 2047])
            codes.append(_steps((values - low) / np.where(high > low, high - low, 1), most))
        alphas = _steps(np.exp(-np.logaddexp(0, -g.logit_opacities[rows].astype(np.float64))), 255)
        vertices[rows, 0] = codes[0] @ [1 << 21, 1 << 11, 1]
        vertices[rows, 1] = _pack_rotations(g.quats[rows])
        vertices[rows, 2] = codes[1] @ [1 << 21, 1 << 11, 1]
        vertices[rows, 3] = codes[2] @ [1 << 24, 1 << 16, 1 << 8] + alphas
    rest = np.clip(np.floor(256 * (0.5 + g.sh[:, 1:].astype(np.float64) / 8)), 0, 255)
    return bounds, vertices, rest.transpose(0, 2, 1).reshape(len(g), 3 * (g.sh.shape[1] - 1)).astype(np.uint8)


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
    low, high = (
        np.repeat(bounds.astype(np.float64).reshape(-1, 3, 2, 3)[:, :, i], CHUNK, 0)[: len(means)] for i in (0, 1)
    )
    for kind, (column, place) in enumerate(((means, 0), (log_scales, 2), (sh[:, 0], 3))):
        packed = vertices[:, place, None]
        if kind == 2:
            share = (packed >> np.array([24, 16, 8], np.uint32) & 255) / 255
        else:
            share = (packed >> np.array([21, 11, 0], np.uint32) & np.array([2047, 1023, 2047], np.uint32)) / (
                2047,
                1023,
                2047,
            )
        values = low[:, kind] + (high - low)[:, kind] * share
        column[:] = (values - 0.5) / SH_C0 if kind == 2 else values
    quats[:] = _unpack_rotations(vertices[:, 1])
    logits[:] = logit_table[vertices[:, 3] & 255]
    codes = rest.reshape(len(means), 3, -1).transpose(0, 2, 1).astype(np.float64)
    sh[:, 1:] = 8 * (np.where(codes == 0, 0, np.where(codes == 255, 1, (codes + 0.5) / 256)) - 0.5)


def _steps(share: Array, most: Array | int) -> Array:
    return np.clip(np.floor(share * most + 0.5), 0, most).astype(np.int64)


def _pack_rotations(quats: Array) -> Array:
    q = quats / np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    largest = np.abs(quats).argmax(axis=1)
    q *= np.where(np.take_along_axis(q, largest[:, None], axis=1) < 0, -1, 1)
    others = q[np.arange(4) != largest[:, None]].reshape(-1, 3)
    return np.asarray(largest * (1 << 30) + _steps(0.5 + np.sqrt(0.5) * others, 1023) @ [1 << 20, 1 << 10, 1])


def _unpack_rotations(packed: Array) -> Array:
    largest = (packed >> 30).astype(np.int64)
    codes = packed[:, None] >> np.array([20, 10, 0], np.uint32) & 1023
    others = (codes / 1023 - 0.5) * np.sqrt(2)
    q = np.zeros((len(packed), 4))
    q[np.arange(4) != largest[:, None]] = others.reshape(-1)
    top = np.sqrt(np.maximum(1 - (others * others).sum(axis=1), 0))
    np.put_along_axis(q, largest[:, None], top[:, None], axis=1)
    return q
