"""What each cluster and each tile of a frame took, as a small file for simulators of hardware.

A frame's work follows from few numbers: a cluster that is kept has its rows read, its survivors are binned, their pairs sorted;
a tile reads entries of its list until its pixels are finished. `frame_counters` takes them from what `trace` leaves
with ``Wanted(last_pair=True)``, which counts by the definition, the same on every device;
`write_counters` keeps them as .npz, which any NumPy reads: one array for each field of `FrameCounters`.
"""

import os
from dataclasses import dataclass, fields

import numpy as np

from splatree.io.replacing import replacing
from splatree.scene.arguments import checked
from splatree.scene.frame import Frame
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Int32, Int64, check_fields

__all__ = ["FrameCounters", "frame_counters", "write_counters"]


@dataclass(frozen=True, eq=False)
class FrameCounters:
    """Work of one view. Arrays by cluster are empty for a scene without clusters.

    Example:
        >>> counters = st.frame_counters(scene, st.trace(scene, camera))
        >>> int(counters.num_tiles_xy.prod()) == len(counters.tile_length)
        True
    """

    cluster_rows: Int32[Array, "c"]
    """Number of Gaussians of each cluster."""
    cluster_kept: Bool[Array, "c"]
    """Whether step 0 kept the cluster."""
    cluster_survivors: Int64[Array, "c"]
    """Number of its drawn Gaussians that touch the image."""
    cluster_pairs: Int64[Array, "c"]
    """Number of their pairs with tiles."""
    tile_length: Int64[Array, "t"]
    """Number of entries of each tile's list; tiles of 16 × 16 px, row by row."""
    tile_consumed: Int64[Array, "t"]
    """Number of entries that were read before all pixels of the tile were finished, which is checked every 32 entries."""
    tile_evaluated: Int64[Array, "t"]
    """Number of evaluations of a splat's opacity at a pixel."""
    tile_blended: Int64[Array, "t"]
    """Number of evaluations that were added to a pixel."""
    num_tiles_xy: Int64[Array, "2"]
    """Number of tiles across and down."""

    def __post_init__(self) -> None:
        check_fields(self)


@checked
def frame_counters(scene: Scene, frame: Frame) -> FrameCounters:
    """Count the work of a traced frame by cluster and by tile.

    Args:
        scene: the scene that was drawn.
        frame: the traced frame.

    Returns:
        The counters.

    Example:
        >>> counters = st.frame_counters(scene, st.trace(scene, camera))
        >>> len(counters.cluster_rows) == len(scene.clusters)
        True
    """
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


@checked
def write_counters(counters: FrameCounters, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write counters as .npz, whole or not at all.

    Args:
        counters: the counters of a view.
        path: the new file, .npz.
        force: replace the file if it exists.

    Raises:
        OutputError: the file exists and ``force`` is not set, or cannot be written.

    Example:
        >>> from pathlib import Path
        >>> st.write_counters(st.frame_counters(scene, st.trace(scene, camera)), Path("view.npz"))
        >>> "tile_length" in np.load("view.npz")
        True
    """
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **{f.name: getattr(counters, f.name) for f in fields(counters)})
