"""Columns of floats as bytes and back, by the compiled loops; ``reference/quantize.py`` is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
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
    """Fill ``codes`` with the nearest multiple of ``step`` to ``scale · value + offset``, held within 0 to 255.

    The values of a row are the ``w`` behind the first ``skip``; scale, offset and step (a power of two) are one for all or
    one for each.
    """
    width = codes.shape[1]
    assert len(values) == len(codes)
    scales, offsets = _each(scale, width, np.float32), _each(offset, width, np.float32)
    _core.bytes_from_values(values, skip, scales, offsets, _each(step, width, np.int32), codes, threads)


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
    width = codes.shape[1]
    assert len(values) == len(codes)
    scales, offsets = _each(scale, width, np.float32), _each(offset, width, np.float32)
    _core.values_from_bytes(codes, scales, offsets, values, skip, threads)


def bytes_from_logits(logits: Float32[Array, "n"], codes: UInt8[Array, "n"], *, threads: int = 0) -> None:
    """Fill ``codes`` with the opacity of each logit, 255 for 1."""
    assert len(logits) == len(codes)
    _core.bytes_from_logits(logits, codes, threads)


def fixed_from_means(
    means: Float32[Array, "n 3"],
    codes: UInt8[Array, "n 9"],
    *,
    signs: Float32[Array, "3"],
    scale: float,
    threads: int = 0,
) -> None:
    """Fill ``codes`` with ``scale · signs · means`` in 24 bits each, little-endian; they must fit."""
    assert len(means) == len(codes)
    _core.fixed_from_means(means, signs, scale, codes, threads)


def means_from_fixed(
    codes: UInt8[Array, "n 9"], means: Float32[Array, "n 3"], *, scale: float, threads: int = 0
) -> None:
    """Fill ``means`` with ``scale`` times the numbers of 24 bits in ``codes``."""
    assert len(means) == len(codes)
    _core.means_from_fixed(codes, scale, means, threads)


def codes_from_quats(
    quats: Float32[Array, "n 4"], codes: UInt8[Array, "n b"], *, signs: Float32[Array, "4"], threads: int = 0
) -> None:
    """Fill ``codes`` with the quaternions wxyz times ``signs``: their smallest three in four bytes, or xyz in three."""
    assert len(quats) == len(codes)
    _core.codes_from_quats(quats, signs, codes, threads)


def quats_from_codes(codes: UInt8[Array, "n b"], quats: Float32[Array, "n 4"], *, threads: int = 0) -> None:
    """Fill ``quats`` with the quaternions wxyz of codes of four or three bytes."""
    assert len(quats) == len(codes)
    _core.quats_from_codes(codes, quats, threads)


def _each(value: Array | float, width: int, dtype: type) -> Array:
    return np.ascontiguousarray(np.broadcast_to(np.asarray(value, dtype), width))
