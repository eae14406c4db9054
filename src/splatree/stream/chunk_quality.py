"""How far the levels of each chunk of a streamed SOG are from its finest level: PSNR over six pictures of the chunk alone."""

import math
from dataclasses import dataclass

import numpy as np

from splatree.progress import track
from splatree.stream.errors import chunk_pictures, chunk_views
from splatree.stream.readers.sog_stream import SogStream

__all__ = ["ChunkQuality", "quality_of_chunks"]

_SIDE_MAX_PX = 256
"""Larger pictures of a chunk say the same and take longer."""


@dataclass(frozen=True)
class ChunkQuality:
    """The levels of one chunk of a streamed SOG."""

    chunk: int
    """Its number, in the order of the tree."""
    num_nodes: tuple[int, ...]
    """Gaussians of each level, finest first."""
    psnr_db: tuple[float | None, ...]
    """Of each level against the finest, from six sides over black; None of the finest, of a level that the chunk does not have,
    and where every bit is the same."""


def quality_of_chunks(stream: SogStream) -> tuple[ChunkQuality, ...]:
    """The quality of every level of every chunk, of what is decoded from the files."""
    num_levels, num_chunks = stream.ranges.counts.shape
    found = []
    for chunk in track(range(num_chunks), "judge chunks"):
        counts = stream.ranges.counts[:, chunk].tolist()
        present = [level for level in range(num_levels) if counts[level]]
        finest = stream.rows_of(chunk, present[0])
        views = chunk_views(finest, stream.ranges.boxes[chunk], most_px=_SIDE_MAX_PX)
        truth = [np.clip(p[:, :, :3], 0, 1) for p in chunk_pictures(finest, views, stream.mode)]
        quality: list[float | None] = [None] * num_levels
        for level in present[1:]:
            pictures = chunk_pictures(stream.rows_of(chunk, level), views, stream.mode)
            squares = [np.square(np.clip(p[:, :, :3], 0, 1) - t) for p, t in zip(pictures, truth, strict=True)]
            mean = float(np.mean(squares, dtype=np.float64))
            quality[level] = -10 * math.log10(mean) if mean > 0 else None
        found.append(ChunkQuality(chunk, tuple(counts), tuple(quality)))
    return tuple(found)
