"""The pixels of SOG in one pass over the rows; `kernels/reference/sog.py` is their specification."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.sog import SogDamage, SogTables
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int32, UInt8

__all__ = ["SogTables", "decode", "encode", "find_codes"]


def encode(
    gaussians: Gaussians,
    places: Int32[Array, "n"],
    mean_ranges: Float64[Array, "2 3"],
    bounds: tuple[Float32[Array, "255"], Float32[Array, "255"]],
    pixels: dict[str, UInt8[Array, "m c"]],
    *,
    labels: Int32[Array, "n"] | None = None,
    threads: int = 0,
) -> None:
    """Set the pixel ``places`` of each row in each picture; a code counts the ``bounds``, of log-scales and of DC, below."""
    _core.encode_sog(gaussians, places, labels, mean_ranges, *bounds, pixels, threads)


def find_codes(values: Float32[Array, "..."], bounds: Float32[Array, "255"], *, threads: int = 0) -> Array:
    """The number of ``bounds``, ascending, below each value; uint8 of the values' shape."""
    codes = np.empty(values.shape, np.uint8)
    _core.find_codes(values.reshape(-1), bounds, codes.reshape(-1), threads)
    return codes


def decode(pixels: dict[str, UInt8[Array, "n c"]], tables: SogTables, out: Gaussians, *, threads: int = 0) -> SogDamage:
    """Fill the columns of ``out`` from as many pixels of each picture (those of `encode`, and labels if there are any)."""
    return SogDamage(*_core.decode_sog(pixels, tables, out, threads))
