"""The pixels of SOG in one pass over the rows; `kernels/reference/sog.py` is their specification."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.sog import SogDamage, SogTables
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int32, UInt8

__all__ = ["SogTables", "decode", "encode", "find_codes"]


def encode(
    gaussians: Gaussians,
    order: Int32[Array, "n"],
    mean_ranges: Float64[Array, "2 3"],
    scale_bounds: Float32[Array, "255"],
    dc_bounds: Float32[Array, "255"],
    *,
    threads: int = 0,
) -> dict[str, UInt8[Array, "n c"]]:
    """Codes of each picture, in the given order of rows; a code of a codebook is the number of bounds below the value."""
    g = gaussians
    channels = {"means_l": 3, "means_u": 3, "quats": 4, "scales": 3, "sh0": 4}
    pixels = {name: np.empty((len(order), c), np.uint8) for name, c in channels.items()}
    _core.encode_sog(
        *(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh, order, mean_ranges, scale_bounds, dc_bounds),
        *pixels.values(),
        threads,
    )
    return pixels


def find_codes(values: Float32[Array, "..."], bounds: Float32[Array, "255"], *, threads: int = 0) -> Array:
    """The number of ``bounds``, ascending, below each value; uint8 of the values' shape."""
    codes = np.empty(values.shape, np.uint8)
    _core.find_codes(values.reshape(-1), bounds, codes.reshape(-1), threads)
    return codes


def decode(pixels: dict[str, UInt8[Array, "n c"]], tables: SogTables, out: Gaussians, *, threads: int = 0) -> SogDamage:
    """Fill the columns of ``out`` from as many pixels of each picture (those of `encode`, and labels if there are any)."""
    none = np.empty((0, 1), np.uint8)
    palette = none if tables.palette is None else tables.palette
    rest = np.empty(256, np.float32) if tables.rest is None else tables.rest
    return SogDamage(
        *_core.decode_sog(
            *(pixels.get(name, none) for name in ("means_l", "means_u", "quats", "scales", "sh0", "labels")),
            *(tables.means, tables.log_scales, tables.dc, tables.logits, rest, palette),
            *(out.means, out.quats, out.log_scales, out.logit_opacities, out.sh),
            threads,
        )
    )
