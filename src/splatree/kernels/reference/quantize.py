"""Columns of floats as bytes and back: what the fast kernels must give.

A byte is the nearest multiple of a step to ``scale · value + offset``, halves to even before the step and up at it; a fixed-point
number is rounded with halves away from zero. A quaternion becomes its smallest three components, in the places x, y, z, w: the
place of the largest in the top two bits, then for each other, in order, a sign and nine bits of ``511 √2 |q|``; the largest is
made positive, as q and −q are one rotation. Or, older, it becomes ``127.5 + 127.5 q`` of x, y, z with w made positive.
"""

import numpy as np

from splatree.shapes import Array, Float32, UInt8

__all__ = [
    "bytes_from_logits",
    "bytes_from_values",
    "codes_from_quats",
    "fixed_from_means",
    "means_from_fixed",
    "quats_from_codes",
    "values_from_bytes",
]


def bytes_from_values(
    values: Float32[Array, "n s"],
    codes: UInt8[Array, "n w"],
    *,
    scale: Array | float,
    offset: Array | float,
    step: Array | int = 1,
    skip: int = 0,
    threads: int = 0,
) -> None:
    """Fill ``codes`` with the nearest multiple of ``step`` to ``scale · value + offset``, held within 0 to 255."""
    rows = values[:, skip : skip + codes.shape[1]].astype(np.float64)
    nearest = np.rint(rows * scale + offset)
    codes[:] = np.clip(np.floor((nearest + np.asarray(step) // 2) / step) * step, 0, 255)


def values_from_bytes(
    codes: UInt8[Array, "n w"],
    values: Float32[Array, "n s"],
    *,
    scale: Array | float,
    offset: Array | float,
    skip: int = 0,
    threads: int = 0,
) -> None:
    """Fill the ``w`` values behind the first ``skip`` of each row with ``scale · code + offset``."""
    values[:, skip : skip + codes.shape[1]] = codes.astype(np.float64) * scale + offset


def bytes_from_logits(logits: Float32[Array, "n"], codes: UInt8[Array, "n"], *, threads: int = 0) -> None:
    """Fill ``codes`` with the opacity of each logit, 255 for 1."""
    codes[:] = np.rint(255 * np.exp(-np.logaddexp(0, -logits.astype(np.float64))))


def fixed_from_means(
    means: Float32[Array, "n 3"],
    codes: UInt8[Array, "n 9"],
    *,
    signs: Float32[Array, "3"],
    scale: float,
    threads: int = 0,
) -> None:
    """Fill ``codes`` with ``scale · signs · means`` in 24 bits each, little-endian; they must fit."""
    values = means.astype(np.float64) * signs * scale
    fixed = np.trunc(values + np.copysign(0.5, values)).astype("<i4")
    codes[:] = np.ascontiguousarray(fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3]).reshape(-1, 9)


def means_from_fixed(
    codes: UInt8[Array, "n 9"], means: Float32[Array, "n 3"], *, scale: float, threads: int = 0
) -> None:
    """Fill ``means`` with ``scale`` times the numbers of 24 bits in ``codes``."""
    low, middle, high = (codes.reshape(-1, 3, 3)[..., i].astype(np.int64) for i in range(3))
    fixed = low + 256 * middle + 65536 * high
    means[:] = np.where(fixed < 1 << 23, fixed, fixed - (1 << 24)) * scale


def codes_from_quats(
    quats: Float32[Array, "n 4"], codes: UInt8[Array, "n b"], *, signs: Float32[Array, "4"], threads: int = 0
) -> None:
    """Fill ``codes`` with the quaternions wxyz times ``signs``: their smallest three in four bytes, or xyz in three."""
    q = (quats.astype(np.float64) * signs)[:, [1, 2, 3, 0]]  # in the places x, y, z, w
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    if codes.shape[1] == 3:
        q *= np.where(q[:, 3:] < 0, -1, 1)
        codes[:] = np.clip(np.rint(127.5 * q[:, :3] + 127.5), 0, 255)
        return
    largest = np.abs(q).argmax(axis=1)
    q *= np.where(np.take_along_axis(q, largest[:, None], axis=1) < 0, -1, 1)
    others = q[np.arange(4) != largest[:, None]].reshape(-1, 3)
    ten_bits = np.floor(511 * np.sqrt(2) * np.abs(others) + 0.5) + np.where(others < 0, 512, 0)
    packed = largest * 2.0**30 + ten_bits @ [2.0**20, 2.0**10, 1]
    codes[:] = packed.astype("<u4")[:, None].view(np.uint8)


def quats_from_codes(codes: UInt8[Array, "n b"], quats: Float32[Array, "n 4"], *, threads: int = 0) -> None:
    """Fill ``quats`` with the quaternions wxyz of codes of four or three bytes."""
    q = np.zeros((len(codes), 4))  # in the places x, y, z, w
    if codes.shape[1] == 3:
        largest = np.full(len(codes), 3)
        others = codes / 127.5 - 1
    else:
        packed = np.ascontiguousarray(codes).view("<u4")[:, 0]
        largest = packed >> 30
        ten_bits = (packed[:, None] >> np.array([20, 10, 0], np.uint32)) & 1023
        others = (ten_bits & 511) / (511 * np.sqrt(2)) * np.where(ten_bits & 512, -1, 1)
    q[np.arange(4) != largest[:, None]] = others.reshape(-1)
    top = np.sqrt(np.maximum(1 - (others * others).sum(axis=1), 0))
    np.put_along_axis(q, largest[:, None].astype(np.int64), top[:, None], axis=1)
    quats[:] = q[:, [3, 0, 1, 2]]
