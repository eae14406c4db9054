"""Clusters of a scene, so that each is one run of rows.

A flat scene is put into clusters by K-means on its means (Jo 2024, §3.2) and permuted: clusters along a Morton curve, rows inside
of a cluster too, ids kept, so that pictures have the same bits as before. Optionally the largest tenth of the Gaussians is put
into clusters of its own, a quarter of all: few large ones would widen the spheres of all the others.

A tree keeps its order: its clusters are complete subtrees, siblings together up to a size, and each node above them by itself.
So the bounds of a subtree hold all its descendants, and leaving a cluster out composes with any cut.

Radii (Jo 2024, Eq. 1, 2) and boxes are computed after the last assignment and against the centres as stored:
kernels/reference/spheres.py.
Cost: a sort, and eleven steps of K-means; 5 M rows in 32,768 clusters take 10 CPU-seconds in all.
"""

import json
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from splatree.clusters.kmeans import ROWS_AT_ONCE, KMeans, Zeros, kmeans
from splatree.errors import InputError
from splatree.kernels.cpu.build.spheres import bound_clusters
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.devices import DeviceName
from splatree.maths.morton import morton_codes
from splatree.scene.arguments import checked
from splatree.scene.given import check_threads, given
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array, Bool, Float32, Float64, Int32, UInt8

__all__ = [
    "ClusterOptions",
    "Placed",
    "build_clusters",
    "chosen_number",
    "middles",
    "placed",
    "subtree_runs",
    "with_rules",
]

VERSION = 2
"""Of the rules by which clusters are made, as written into files: 2 has boxes."""

ROWS_PER_CLUSTER = 128
"""Rows of a cluster where their number is left open, within the limits below."""
FEWEST, MOST = 1024, 32768
"""Clusters where their number is left open: more cost more records than they save rows."""
LARGE_SHARE, LARGE_CLUSTERS = 0.1, 0.25
"""Size classes: the largest tenth of the Gaussians gets a quarter of the clusters."""


@dataclass(frozen=True)
class ClusterOptions:
    """How clusters are made.

    Example:
        >>> flat = st.read("city.ply")
        >>> st.build_clusters(flat, 9, st.ClusterOptions(size_classes=True)).clusters is not None
        True
    """

    iterations: int = 10
    """Largest number of iterations of K-means."""
    size_classes: bool = False
    """Put the largest tenth of the Gaussians into clusters of their own, which makes the other spheres tighter. Off: as in Jo
    2024."""
    seed: int = 0
    """Seed of the random points that are the first centres of K-means."""
    device: DeviceName = "cpu"
    """Where K-means runs. Scenes with levels need no K-means."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.iterations < 0:
            raise InputError(f"iterations: found {self.iterations}, wanted 0 or more")
        if self.seed < 0:
            raise InputError(f"seed: found {self.seed}, wanted 0 or more")


@checked
def build_clusters(
    scene: Scene,
    num_clusters: int | Literal["auto"] = "auto",
    options: ClusterOptions | None = None,
    *,
    threads: int = 0,
) -> Scene:
    """Add clusters to a scene, by which whole runs of rows are left out of a frame.

    The rows of a flat scene are permuted so that each cluster is one run. A scene with levels keeps its order.

    Args:
        scene: any scene.
        num_clusters: number of clusters for K-means; coinciding points may leave some empty, which are dropped. In a tree it
            sets the size of the subtrees, and the number comes out near it. `auto`: one for 128 rows, from 1,024 to 32,768.
        options: how clusters are made; None: the defaults.
        threads: threads to use; 0: all. The result is the same for any number.

    Returns:
        The scene with its ``clusters``.

    Raises:
        InputError: there are fewer rows than clusters, or rows that are not finite.

    Source:
        Jo 2024, §3, Eq. 1 and 2; docs/explanation/clusters.md.

    Example:
        >>> clustered = st.build_clusters(st.read("city.ply"), 9)
        >>> len(clustered.clusters)
        9
    """
    options = given(options, ClusterOptions, "options of clusters")
    check_threads(threads)
    n = len(scene)
    count = chosen_number(num_clusters, n)
    is_flat = scene.tree.num_leaves == n
    if is_flat:
        scene, start, centers = _by_kmeans(scene, count, options, threads)
    else:
        start = subtree_runs(scene.tree.subtree_end, scene.tree.depth, 2 * n // count)
        centers = middles(scene.gaussians.means, start)
    return replace(
        scene,
        blocks=scene.blocks or index_blocks(scene.gaussians, scene.tree, threads=threads),
        clusters=bound_clusters(scene.gaussians, start, centers, threads=threads),
        source=with_rules(scene.source, len(centers), options if is_flat else None),
    )


def chosen_number(num_clusters: int | Literal["auto"], num_rows: int) -> int:
    """The number of clusters that is asked for; `auto`: a power of two near one for 128 rows.

    Raises:
        InputError: there are no rows, or fewer than clusters.
    """
    if num_rows == 0:
        raise InputError("clusters: found a scene without Gaussians, wanted at least one")
    if num_clusters == "auto":
        return min(num_rows, int(2 ** np.round(np.log2(np.clip(num_rows / ROWS_PER_CLUSTER, FEWEST, MOST)))))
    if not 1 <= num_clusters <= num_rows:
        raise InputError(
            f"clusters: found {num_clusters} for {num_rows} Gaussians, wanted 1 to {num_rows}, one for each of them"
        )
    return num_clusters


def with_rules(source: Source, num_clusters: int, options: ClusterOptions | None) -> Source:
    """The source of a scene with clusters: how they were made; ``options`` None: as subtrees."""
    rules = {"version": VERSION, "rule": "subtrees" if options is None else "kmeans", "clusters": num_clusters}
    if options is not None:
        rules |= {"iterations": options.iterations, "size_classes": options.size_classes, "seed": options.seed}
    return replace(source, metadata={**source.metadata, "clusters": json.dumps(rules)})


@dataclass(frozen=True, eq=False)
class Placed:
    """Clusters of rows along a Morton curve, and where each row goes so that they are runs."""

    start: Int32[Array, "c+1"]
    """First row of each cluster, and the number of rows."""
    centers: Float32[Array, "c 3"]
    """Their centres."""
    places: Int32[Array, "n"]
    """New row of each row along the curve."""


def placed(
    means: Float32[Array, "n 3"],
    sizes: Float32[Array, "n"] | None,
    count: int,
    options: ClusterOptions,
    *,
    threads: int = 0,
    zeros: Zeros = np.zeros,
) -> Placed:
    """Put rows along a Morton curve into clusters by K-means.

    Args:
        means: of the rows.
        sizes: logarithm of the largest standard deviation of each, where large rows get clusters of their own; else None.
        count: number of clusters.
        options: how they are made.
        threads: threads to use; 0: all.
        zeros: makes the arrays that have a row for each row; they may lie in files.
    """
    n, rng = len(means), np.random.default_rng(options.seed)

    def made(points: Array, share: int) -> KMeans:
        return kmeans(
            points, share, iterations=options.iterations, rng=rng, threads=threads, device=options.device, zeros=zeros
        )

    if sizes is None or count < 2:
        found = made(means, count)
        return _along_curve(found.labels, found.centers, zeros)
    few = max(1, round(LARGE_CLUSTERS * count))
    is_large = _large(sizes, max(few, round(LARGE_SHARE * n)), zeros)
    labels, centers = zeros((n,), np.int32), np.empty((0, 3))
    for of_class, share in ((False, count - few), (True, few)):
        ends = np.cumsum([0, *(np.count_nonzero(is_large[part] == of_class) for part in _parts(n))])
        points = zeros((int(ends[-1]), 3), np.float32)
        for part, begin, end in zip(_parts(n), ends[:-1], ends[1:], strict=True):
            points[begin:end] = means[part][is_large[part] == of_class]
        found = made(points, min(share, len(points)))
        for part, begin, end in zip(_parts(n), ends[:-1], ends[1:], strict=True):
            labels[part][is_large[part] == of_class] = found.labels[begin:end] + len(centers)
        centers = np.concatenate([centers, found.centers])
    return _along_curve(labels, centers, zeros)


def _parts(num_rows: int) -> list[slice]:
    return [slice(begin, begin + ROWS_AT_ONCE) for begin in range(0, num_rows, ROWS_AT_ONCE)]


def _large(sizes: Float32[Array, "n"], count: int, zeros: Zeros) -> Bool[Array, "n"]:
    """Which rows are the largest; of those as large as the smallest of them the first along the curve."""
    in_order, is_large = zeros((len(sizes),), np.float32), zeros((len(sizes),), np.bool_)
    in_order[:] = sizes
    in_order.partition(len(sizes) - count)
    least = in_order[len(sizes) - count]
    num_left = count - sum(int((sizes[part] > least).sum()) for part in _parts(len(sizes)))
    for part in _parts(len(sizes)):
        is_large[part] = sizes[part] > least
        as_large = np.flatnonzero(sizes[part] == least)[:num_left]
        is_large[part][as_large] = True
        num_left -= len(as_large)
    return is_large


def _along_curve(labels: Int32[Array, "n"], centers: Float64[Array, "c 3"], zeros: Zeros) -> Placed:
    """Clusters along the curve too, without those that are empty; rows of a cluster stay in order."""
    rank = np.empty(len(centers), np.int32)  # of each cluster along the curve
    rank[np.argsort(morton_codes(centers), kind="stable")] = np.arange(len(centers))
    counts = np.zeros(len(centers), np.int64)
    for part in _parts(len(labels)):
        counts += np.bincount(rank[labels[part]], minlength=len(centers))
    places, following = zeros((len(labels),), np.int32), np.cumsum(counts) - counts
    for part in _parts(len(labels)):
        ranks = rank[labels[part]]
        order = np.argsort(ranks, kind="stable")
        own = np.bincount(ranks, minlength=len(centers))
        places[part][order] = np.arange(len(order)) + np.repeat(following - (np.cumsum(own) - own), own)
        following += own
    in_order = np.empty_like(centers)
    in_order[rank] = centers
    start = np.concatenate([[0], np.cumsum(counts[counts > 0])]).astype(np.int32)
    return Placed(start, in_order[counts > 0].astype(np.float32), places)


def _by_kmeans(scene: Scene, count: int, options: ClusterOptions, threads: int) -> tuple[Scene, Array, Array]:
    """The permuted scene, the first rows of its clusters and their centres."""
    gaussians = scene.gaussians
    order = np.argsort(morton_codes(gaussians.means), kind="stable")
    sizes = gaussians.log_scales.max(axis=1)[order] if options.size_classes else None
    found = placed(np.take(gaussians.means, order, axis=0), sizes, count, options, threads=threads)
    rows = np.empty_like(order)
    rows[found.places] = order
    return _permuted(scene, rows), found.start, found.centers


def _permuted(scene: Scene, rows: Array) -> Scene:
    """A flat scene with its rows in another order."""
    n = len(scene)
    ids = np.arange(n, dtype=np.uint32) if scene.ids is None else scene.ids
    tree = replace(
        scene.tree,
        extents=scene.tree.extents[rows],
        curves=None if scene.tree.curves is None else scene.tree.curves[rows],
        roots=None,
    )
    return replace(scene, gaussians=scene.gaussians.take(rows), tree=tree, ids=ids[rows], blocks=None, clusters=None)


def subtree_runs(end: Int32[Array, "n"], depth: UInt8[Array, "n"], most_rows: int) -> Int32[Array, "c+1"]:
    """First rows of runs that each hold complete subtrees of at most ``most_rows`` rows, or one node above such; and the end.

    Args:
        end: one past the last row of the subtree of each row.
        depth: edges from the root.
        most_rows: of a run.
    """
    start, row, n = [0], 0, len(end)
    while row < n:
        first, level = row, depth[row]
        row += 1
        if end[first] - first <= most_rows:
            row = int(end[first])
            # Siblings go along while there is room.
            while row < n and depth[row] == level and end[row] - first <= most_rows:
                row = int(end[row])
        start.append(row)
    return np.array(start, np.int32)


def middles(means: Float32[Array, "n 3"], start: Int32[Array, "c+1"]) -> Float32[Array, "c 3"]:
    """Middle of the box of each run's means."""
    with np.errstate(invalid="ignore", over="ignore"):
        low, high = (bound.reduceat(means, start[:-1], axis=0).astype(np.float64) for bound in (np.fmin, np.fmax))
        return np.asarray(((low + high) / 2).astype(np.float32))
