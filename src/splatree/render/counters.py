"""What each cluster and each tile of a frame took, as a small file for simulators of hardware.

A frame's work follows from few numbers: a cluster that is kept has its rows read, its survivors are binned, their pairs sorted;
a tile reads entries of its list until its pixels are finished. `frame_counters` takes them from what `trace` leaves
with ``Wanted(last_pair=True)``, which counts by the definition, the same on every device;
`write_counters` keeps them as .npz, which any NumPy reads: one array for each field of `FrameCounters`.
"""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from splatree.io.replacing import replacing
from splatree.scene.frame import Frame
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Int32, Int64, check_fields

__all__ = ["FrameCounters", "frame_counters", "write_counters"]


@dataclass(frozen=True, eq=False)
class FrameCounters:
    """Work of one view; arrays by cluster are empty for a scene without clusters."""

    cluster_rows: Int32[Array, "c"]
    """Gaussians of each cluster."""
    cluster_kept: Bool[Array, "c"]
    """Whether step 0 kept it."""
    cluster_survivors: Int64[Array, "c"]
    """Its Gaussians that touch the image, of those that were drawn."""
    cluster_pairs: Int64[Array, "c"]
    """Pairs of these with tiles."""
    tile_length: Int64[Array, "t"]
    """Entries of each tile's list; tiles of 16 × 16 px row by row."""
    tile_consumed: Int64[Array, "t"]
    """Entries that the pixels of each tile read, by the definition of `TileWork` if the frame was traced with `last_pair`."""
    tile_evaluated: Int64[Array, "t"]
    """Evaluations of a splat's opacity at a pixel, by the same definition: the sum of the entries that each pixel reads."""
    tile_blended: Int64[Array, "t"]
    """Evaluations that were added to a pixel."""
    num_tiles_xy: Int64[Array, "2"]
    """Tiles across and down."""

    def __post_init__(self) -> None:
        check_fields(self)


def frame_counters(scene: Scene, frame: Frame) -> FrameCounters:
    """Count a traced frame by cluster and by tile."""
    start = np.zeros(1, np.int32) if scene.clusters is None else scene.clusters.start
    count = len(start) - 1
    kept = np.ones(count, bool) if frame.culling is None else frame.culling.kept
    cluster = np.searchsorted(start, frame.splats.rows, side="right") - 1 if count else np.zeros(0, np.int64)
    pairs = np.bincount(frame.bins.splat_from_pair, minlength=len(frame.splats))[: len(cluster)]
    work = frame.tiles
    return FrameCounters(
        cluster_rows=np.diff(start),
        cluster_kept=kept,
        cluster_survivors=np.bincount(cluster, minlength=count).astype(np.int64),
        cluster_pairs=np.bincount(cluster, weights=pairs, minlength=count).astype(np.int64),
        tile_length=np.diff(frame.bins.tile_start),
        tile_consumed=work.consumed,
        tile_evaluated=work.evaluated,
        tile_blended=work.blended,
        num_tiles_xy=np.array([frame.bins.num_tiles_x, frame.bins.num_tiles_y], np.int64),
    )


def write_counters(counters: FrameCounters, path: Path, *, force: bool = False) -> None:
    """Write them as .npz, whole or not at all.

    Raises:
        OutputError: the file exists and ``force`` is not set, or cannot be written.
    """
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **{f.name: getattr(counters, f.name) for f in fields(counters)})
