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

from splatree.clusters.kmeans import kmeans
from splatree.errors import InputError
from splatree.kernels.cpu.build.spheres import bound_clusters
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.devices import DeviceName
from splatree.maths.morton import morton_codes
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Int32

__all__ = ["ClusterOptions", "build_clusters"]

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
    options = options or ClusterOptions()
    n = len(scene)
    if n == 0:
        raise InputError("clusters: found a scene without Gaussians, wanted at least one")
    count = _number_for(n) if num_clusters == "auto" else num_clusters
    if not 1 <= count <= n:
        raise InputError(f"clusters: found {count} for {n} Gaussians, wanted 1 to {n}, one for each of them")
    is_flat = scene.tree.num_leaves == n
    if is_flat:
        scene, start, centers = _by_kmeans(scene, count, options, threads)
    else:
        start = subtree_runs(scene.tree, 2 * n // count)
        centers = _middles(scene.gaussians.means, start)
    rules = {"version": VERSION, "rule": "kmeans" if is_flat else "subtrees", "clusters": len(centers)}
    if is_flat:
        rules |= {"iterations": options.iterations, "size_classes": options.size_classes, "seed": options.seed}
    metadata = {**scene.source.metadata, "clusters": json.dumps(rules)}
    return replace(
        scene,
        blocks=scene.blocks or index_blocks(scene.gaussians, scene.tree, threads=threads),
        clusters=bound_clusters(scene.gaussians, start, centers, threads=threads),
        source=replace(scene.source, metadata=metadata),
    )


def _number_for(num_rows: int) -> int:
    """A power of two near one for 128 rows."""
    return min(num_rows, int(2 ** np.round(np.log2(np.clip(num_rows / ROWS_PER_CLUSTER, FEWEST, MOST)))))


def _by_kmeans(scene: Scene, count: int, options: ClusterOptions, threads: int) -> tuple[Scene, Array, Array]:
    """The permuted scene, the first rows of its clusters and their centres."""
    order = np.argsort(morton_codes(scene.gaussians.means), kind="stable")
    means = np.take(scene.gaussians.means, order, axis=0)
    rng = np.random.default_rng(options.seed)
    labels, centers = np.empty(len(scene), np.int32), np.empty((0, 3))
    for members, share in _size_classes(scene.gaussians, order, count, options.size_classes):
        found = kmeans(
            means[members], share, iterations=options.iterations, rng=rng, threads=threads, device=options.device
        )
        labels[members] = found.labels + len(centers)
        centers = np.concatenate([centers, found.centers])

    rank = np.empty(len(centers), np.int32)  # of each cluster along the curve
    rank[np.argsort(morton_codes(centers), kind="stable")] = np.arange(len(centers))
    labels = rank[labels]
    rows = order[np.argsort(labels, kind="stable")]
    sizes = np.bincount(labels, minlength=len(centers))
    start = np.concatenate([[0], np.cumsum(sizes[sizes > 0])]).astype(np.int32)
    in_order = np.empty_like(centers)
    in_order[rank] = centers
    return _permuted(scene, rows), start, in_order[sizes > 0].astype(np.float32)


def _size_classes(gaussians: Gaussians, order: Array, count: int, apart: bool) -> list[tuple[Array | slice, int]]:
    """Rows along the curve that are clustered together, and their number of clusters."""
    few = max(1, round(LARGE_CLUSTERS * count))
    if not apart or count < 2:
        return [(slice(None), count)]
    sizes = gaussians.log_scales.max(axis=1)[order]
    large = np.zeros(len(order), bool)
    num_large = max(few, round(LARGE_SHARE * len(order)))
    large[np.argpartition(-sizes, num_large - 1)[:num_large]] = True
    rest = ~large
    return [(rest, min(count - few, int(rest.sum()))), (large, few)]


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


def subtree_runs(tree: GaussianTree, most_rows: int) -> Int32[Array, "c+1"]:
    """First rows of runs that each hold complete subtrees of at most ``most_rows`` rows, or one node above such; and the end."""
    end, depth = tree.subtree_end, tree.depth
    start, row, n = [0], 0, len(tree)
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


def _middles(means: Array, start: Array) -> Array:
    """Middle of the box of each run's means."""
    with np.errstate(invalid="ignore", over="ignore"):
        low, high = (bound.reduceat(means, start[:-1], axis=0).astype(np.float64) for bound in (np.fmin, np.fmax))
        return np.asarray(((low + high) / 2).astype(np.float32))
