"""The records of a ``.ksplat``: header, section, row; and what their codes stand for."""

import numpy as np

from splatree.constants import SH_C0
from splatree.io.opacities import CODE_STEP, logits_from_opacities
from splatree.shapes import Array

__all__ = [
    "CODE_RANGE",
    "COLORS",
    "HALF_MAX",
    "HALF_MIN",
    "HEADER",
    "HEADER_BYTES",
    "LOGITS",
    "REST_RANGE",
    "SECTION",
    "SECTION_BYTES",
    "SHARE",
    "record_of",
    "rest_order",
]

HEADER_BYTES, SECTION_BYTES = 4096, 1024
HEADER = np.dtype(
    {
        "names": ["major", "minor", "max_sections", "sections", "max_rows", "rows", "level", "centre", "rest_range"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u4", "<u4", "<u2", ("<f4", 3), ("<f4", 2)],
        "offsets": [0, 1, 4, 8, 12, 16, 20, 24, 36],
        "itemsize": HEADER_BYTES,
    }
)
SECTION = np.dtype(
    {
        "names": [
            *("rows", "max_rows", "bucket_rows", "buckets", "block_size", "bucket_bytes"),
            *("code_range", "bytes", "full_buckets", "partial_buckets", "degree"),
        ],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40],
        "itemsize": SECTION_BYTES,
    }
)
REST_RANGE = (-1.5, 1.5)
"""Range of the harmonics of level 2 where the header says 0."""

CODE_RANGE = 32767
"""Steps from a bucket's centre to the side of its block."""

HALF_MAX = 65504.0
HALF_MIN = 2.0**-24
"""Smallest half-precision number above 0; a scale of 0 stands for one below half of it."""

SHARE = np.arange(256) / 255
LOGITS = logits_from_opacities(SHARE, step_low=CODE_STEP, step_high=CODE_STEP)
COLORS = ((SHARE - 0.5) / SH_C0).astype(np.float32)
"""What bytes of opacity and of colour stand for."""


def record_of(level: int, degree: int) -> np.dtype[np.void]:
    num_rest = 3 * ((degree + 1) ** 2 - 1)
    mean, other, rest = [("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1")][level]
    return np.dtype(
        [("mean", mean, 3), ("scale", other, 3), ("quat", other, 4), ("rgba", "u1", 4), ("rest", rest, num_rest)]
    )


def rest_order(degree: int) -> Array:
    """Where each harmonic beyond the DC of a record lies in coefficients with RGB inside."""
    places = [
        3 * (order * order + j - 1) + channel
        for order in range(1, degree + 1)
        for channel in range(3)
        for j in range(2 * order + 1)
    ]
    return np.array(places, np.intp)
