"""What a frame asks of a machine: clusters, survivors, pairs, and the work of each tile.

A trace is taken from a frame that was drawn (`trace_frame`), so that its numbers are those of a real scene, or made to given
rates of exclusion (`trace_of_rates`), such as those of Jo 2024, Table I. It is a few MB as .npz.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from splatree.clusters.cull import cull
from splatree.constants import TILE_PX
from splatree.errors import InputError
from splatree.hardware.levels import unwalked, walk_of
from splatree.io.replacing import replacing
from splatree.render.counters import frame_counters
from splatree.scene.clusters import ClusterIndex
from splatree.scene.frame import Frame, Splats, TileBins
from splatree.scene.scene import Scene
from splatree.shapes import Array, Bool, Float32, Int32, Int64, check_fields

__all__ = ["FrameTrace", "read_trace", "trace_frame", "trace_of_rates", "write_trace"]

SUBTILE_PX = 8
"""Side of the squares in which a renderer evaluates one splat at once."""

BLENDED_SHARE = 0.2
"""Share of evaluations in touched subtiles that are added to a pixel, for traces that are made to rates."""


@dataclass(frozen=True, eq=False)
class FrameTrace:
    """Counts of one frame: everything that the simulator reads."""

    cluster_first_row: Int64[Array, "c"]
    """First row of each cluster."""
    cluster_span: Int64[Array, "c"]
    """All rows of each cluster, levels included."""
    cluster_rows: Int64[Array, "c"]
    """Gaussians of each cluster that are read if it is kept: all, or those of the cut."""
    cluster_walked: Int64[Array, "c"]
    """Rows that the selection of levels looks at; 0 everywhere if the frame was drawn without levels."""
    cluster_walk_units: Int64[Array, "c"]
    """Pieces of 64 bytes in which the records of these rows lie."""
    cluster_is_above: Bool[Array, "c"]
    """Whether the cluster has descendants in other clusters, so that it must be walked before these."""
    cluster_kept: Bool[Array, "c"]
    """Whether identification keeps it."""
    cluster_survivors: Int64[Array, "c"]
    """Its Gaussians that touch the picture."""
    cluster_pairs: Int64[Array, "c"]
    """Pairs of these with tiles."""
    cluster_centers: Float32[Array, "c 3"]
    """Centres, world units: for the order along a Morton curve."""
    tile_length: Int64[Array, "t"]
    """Entries of each tile's list; tiles of 16 × 16 px row by row."""
    tile_consumed: Int64[Array, "t"]
    """Entries that are read before all pixels of the tile are finished."""
    tile_subtiles: Int64[Array, "t"]
    """Of these entries, the 8 × 8 px subtiles that their ellipses touch, added up; four an entry at most."""
    tile_blended: Int64[Array, "t"]
    """Evaluations that were added to a pixel."""
    tile_start: Int64[Array, "t+1"]
    """Where each tile's consumed entries begin in ``pair_splats``."""
    pair_splats: Int32[Array, "m"]
    """Splat of each consumed entry, for the cache of projected records; empty if the trace has no lists."""
    num_tiles_xy: Int64[Array, "2"]
    """Tiles across and down."""
    num_coefficients: int = 16
    """Harmonics of a channel."""

    def __post_init__(self) -> None:
        check_fields(self)
        tiles = int(self.num_tiles_xy[0] * self.num_tiles_xy[1])
        if tiles != len(self.tile_length):
            raise InputError(f"trace: found {len(self.tile_length)} tiles, wanted {tiles}: num_tiles_xy disagrees")
        if min(self.num_tiles_xy) < 0 or not 1 <= self.num_coefficients <= 25:
            raise InputError(
                f"trace: found {self.num_tiles_xy} tiles and {self.num_coefficients} harmonics, wanted 0 or more and 1 to 25"
            )
        columns = ("first_row", "walk_units", "walked", "rows", "survivors", "pairs")
        counts = (*(getattr(self, f"cluster_{name}") for name in columns), self.tile_length, self.tile_consumed)
        if any(np.any(column < 0) for column in counts):
            raise InputError("trace: found negative counts, wanted 0 or more")
        if np.any(self.cluster_survivors > self.cluster_rows) or np.any(self.cluster_rows > self.cluster_span):
            raise InputError(
                "trace: found clusters with more survivors than rows; the trace is of another scene or version"
            )
        starts, listed = self.tile_start, self.pair_splats
        if len(listed) and (
            starts[0] != 0 or np.any(np.diff(starts) < 0) or starts[-1] != len(listed) or listed.min() < 0
        ):
            raise InputError("trace: found lists that are not those of its tiles; the file is damaged, write it anew")

    def is_of_scene_of(self, other: "FrameTrace") -> bool:
        """Whether both frames are of the same scene, judged by its clusters."""
        return np.array_equal(self.cluster_span, other.cluster_span)

    @property
    def has_levels(self) -> bool:
        """Whether a cut of levels of detail was drawn."""
        return bool(self.cluster_walked.any())

    @property
    def num_rows(self) -> int:
        """Gaussians of the scene."""
        return int(self.cluster_rows.sum())

    @property
    def exclusion(self) -> float:
        """Share of the Gaussians whose cluster is left out."""
        return 1 - float(self.cluster_rows[self.cluster_kept].sum()) / max(self.num_rows, 1)

    @property
    def ideal_exclusion(self) -> float:
        """Share of the Gaussians that do not survive step 1."""
        return 1 - float(self.cluster_survivors.sum()) / max(self.num_rows, 1)


def trace_frame(scene: Scene, frame: Frame, *, boxes: bool = False) -> FrameTrace:
    """Take the counts of a traced frame.

    Args:
        scene: the scene that was drawn, with clusters.
        frame: what `trace` left, drawn with a rule of culling.
        boxes: whether the exact rule may look at the boxes of clusters, as `st.cull` does; else at their spheres alone.

    Returns:
        The trace. If levels of detail were drawn, the rows of a cluster are those of the cut.

    Raises:
        InputError: the scene has no clusters.
    """
    if scene.clusters is None:
        raise InputError("trace: found a scene without clusters, wanted some; make them with st.build_clusters(scene)")
    counters = frame_counters(scene, frame)
    consumed = np.minimum(counters.tile_consumed, counters.tile_length)
    pairs = _consumed_pairs(frame.bins.tile_start, consumed)
    splats = frame.bins.splat_from_pair[pairs]
    tiles = np.repeat(np.arange(len(consumed)), consumed)
    touched = _touched_subtiles(frame.splats, frame.bins, splats, tiles)
    clusters, kept = scene.clusters, counters.cluster_kept
    if frame.culling is not None and frame.culling.rule == "exact" and not boxes:
        kept = cull(_without_boxes(clusters), frame.view).kept
    if scene.tree.num_levels > 1 and frame.selection.pixel_error > 0:
        walk, span = walk_of(scene, frame), clusters.counts.astype(np.int64)
        kept = kept & (walk.walked > 0)
    else:  # the leaves are known beforehand, and lie together
        walk = unwalked(np.add.reduceat(scene.tree.is_leaf, clusters.start[:-1], dtype=np.int64))
        span = walk.rows
        kept = kept & (span > 0)
    return FrameTrace(
        cluster_first_row=np.cumsum(span) - span,
        cluster_span=span,
        cluster_rows=walk.rows,
        cluster_walked=walk.walked,
        cluster_walk_units=walk.units,
        cluster_is_above=walk.is_above,
        cluster_kept=kept,
        cluster_survivors=counters.cluster_survivors,
        cluster_pairs=counters.cluster_pairs,
        cluster_centers=scene.clusters.centers,
        tile_length=counters.tile_length,
        tile_consumed=consumed,
        tile_subtiles=np.bincount(tiles, weights=touched, minlength=len(consumed)).astype(np.int64),
        tile_blended=counters.tile_blended,
        tile_start=np.concatenate([[0], np.cumsum(consumed)]),
        pair_splats=splats.astype(np.int32),
        num_tiles_xy=counters.num_tiles_xy,
        num_coefficients=scene.gaussians.sh.shape[1],
    )


def _without_boxes(clusters: ClusterIndex) -> ClusterIndex:
    """An infinite box excludes nothing."""
    everywhere = np.full_like(clusters.box_low, np.inf)
    return replace(clusters, box_low=-everywhere, box_high=everywhere)


def _consumed_pairs(start: Array, consumed: Array) -> Array:
    """Indices of the first so many pairs of each tile."""
    ends = np.cumsum(consumed)
    within = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - consumed, consumed)
    return np.asarray(np.repeat(start[:-1], consumed) + within)


def _touched_subtiles(splats: Splats, bins: TileBins, index: Array, tiles: Array) -> Array:
    """How many of its tile's four 8 × 8 px subtiles the box of each pair's splat meets."""
    centres, half = splats.means_px[index], splats.half_sizes_px[index]
    corner = TILE_PX * np.stack([tiles % bins.num_tiles_x, tiles // bins.num_tiles_x], axis=1)
    low, high = centres - half - corner, centres + half - corner
    first = np.clip(np.floor(low / SUBTILE_PX), 0, 1)
    last = np.clip(np.ceil(high / SUBTILE_PX) - 1, 0, 1)
    return np.asarray(np.prod(last - first + 1, axis=1))


def trace_of_rates(
    num_rows: int,
    *,
    exclusion: float,
    ideal: float,
    num_clusters: int = 8192,
    pairs_per_survivor: float = 6.0,
    num_tiles_xy: tuple[int, int] = (120, 68),
    rng: np.random.Generator,
) -> FrameTrace:
    """Make a trace with given rates, for scenes of which a paper tells only these (Jo 2024, Table I).

    Args:
        num_rows: Gaussians of the scene.
        exclusion: share of them whose cluster is left out.
        ideal: share that does not survive step 1, at least ``exclusion``.
        num_clusters: clusters, of random sizes.
        pairs_per_survivor: tiles that a survivor is listed in, on average.
        num_tiles_xy: tiles across and down; all lists are equally long and consumed to a half.
        rng: source of the sizes and of which clusters are kept.

    Raises:
        InputError: rates outside of 0 to 1, or an ideal below the exclusion.
    """
    if not 0 <= exclusion <= ideal <= 1:
        raise InputError(f"trace: found exclusion {exclusion} and ideal {ideal}, wanted 0 <= exclusion <= ideal <= 1")
    if not 0 < num_clusters <= num_rows:
        raise InputError(f"trace: found {num_clusters} clusters of {num_rows} rows, wanted 1 to {num_rows}")
    sizes = 1 + rng.multinomial(num_rows - num_clusters, rng.dirichlet(np.full(num_clusters, 2.0)))
    kept = np.zeros(num_clusters, bool)
    wanted, order = (1 - exclusion) * num_rows, rng.permutation(num_clusters)
    kept[order[: np.searchsorted(np.cumsum(sizes[order]), wanted) + 1]] = exclusion < 1
    of_kept = float(sizes[kept].sum())
    rate = min(1.0, (1 - ideal) * num_rows / max(of_kept, 1.0))
    survivors = np.where(kept, rng.binomial(sizes, rate), 0)
    pairs = np.rint(survivors * pairs_per_survivor).astype(np.int64)
    tiles = num_tiles_xy[0] * num_tiles_xy[1]
    length = np.full(tiles, pairs.sum() // tiles, np.int64)
    length[: pairs.sum() % tiles] += 1
    walk = unwalked(sizes.astype(np.int64))
    return FrameTrace(
        cluster_first_row=np.cumsum(sizes) - sizes,
        cluster_span=walk.rows,
        cluster_rows=walk.rows,
        cluster_walked=walk.walked,
        cluster_walk_units=walk.units,
        cluster_is_above=walk.is_above,
        cluster_kept=kept,
        cluster_survivors=survivors.astype(np.int64),
        cluster_pairs=pairs,
        cluster_centers=rng.normal(size=(num_clusters, 3)).astype(np.float32),
        tile_length=length,
        tile_consumed=length // 2,
        tile_subtiles=length,
        tile_blended=np.rint(BLENDED_SHARE * length * SUBTILE_PX**2).astype(np.int64),
        tile_start=np.zeros(tiles + 1, np.int64),
        pair_splats=np.zeros(0, np.int32),
        num_tiles_xy=np.array(num_tiles_xy, np.int64),
    )


def write_trace(trace: FrameTrace, path: Path, *, force: bool = False) -> None:
    """Write a trace as .npz, whole or not at all.

    Raises:
        OutputError: the file exists and ``force`` is not set, or cannot be written.
    """
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **{f.name: getattr(trace, f.name) for f in fields(trace)})


def read_trace(path: Path) -> FrameTrace:
    """Read what `write_trace` wrote.

    Raises:
        InputError: the file is no trace, is cut short, or its columns disagree.
    """
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            columns = {f.name: file[f.name] for f in fields(FrameTrace)}
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found; wanted a trace (.npz) that splatree simulate --traces wrote") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as a trace (.npz): {error}") from error
    except KeyError as error:
        raise InputError(
            f"{path}: found no column {error}, wanted a trace of splatree simulate; write it anew"
        ) from error
    except Exception as error:  # zipfile and zlib have errors of their own for what is damaged
        raise InputError(f"{path}: found a damaged file, wanted a trace (.npz): {error}") from error
    columns["num_coefficients"] = int(columns["num_coefficients"])
    return FrameTrace(**columns)
