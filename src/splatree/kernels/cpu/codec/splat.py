"""Records of a .splat from columns, and back: glue over splat.cpp; kernels/reference/splat.py is the definition."""

from typing import BinaryIO

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array

__all__ = ["decode", "encode", "place", "ranks"]


def encode(gaussians: Gaussians, records: Array, *, threads: int = 0) -> float:
    """Write each Gaussian into its 32 bytes of ``records``, uint8 "n 32"; return the largest ``|dc|``, NaN if one is NaN."""
    return float(_core.encode_splats(gaussians, records, threads))


def decode(records: Array, gaussians: Gaussians, *, threads: int = 0) -> None:
    """Fill the columns of ``gaussians``, of degree 0, from ``records``, uint8 "n 32"."""
    _core.decode_splats(records, gaussians, threads)


def ranks(gaussians: Gaussians, out: Array, *, threads: int = 0) -> None:
    """Fill ``out``, uint16, with the place of each row in the file: by descending opacity × volume in quarters of an octave."""
    _core.rank_splats(gaussians, out, threads)


def place(records: Array, ranks: Array, places: Array, file: BinaryIO) -> None:
    """Put ``records``, uint8 "n 32", with ``ranks``, uint16 "n", into a file, those of one rank in their order.

    ``places``, int64, is the record of the file at which each rank goes on; it is moved on.

    Raises:
        OSError: the file cannot be written.
    """
    _core.place_splats(records, ranks, places, file.fileno())
