"""Level of detail by growing radius: a tree whose leaves are the scene and whose inner nodes are merged Gaussians.

Level 0 is the scene. Level l + 1 thins level l with r_l = r_0 g^l: each group of two or more becomes a new node with its
members as children; a group of one moves up itself, so no node has a single child. It ends with at most ``max_roots`` nodes or
when the radius passes the scene's diagonal. Roots and siblings stand along a Morton curve, rows in depth-first preorder.

Weights are summed upwards, so means, covariances and harmonics of a node are those of its leaves. Harmonics above DC play no
part in the grouping; they are averaged at the end, in place, where children follow their parent.

Cost: a thinning and a merge a level, the levels together two to four times the leaves; memory: the result, plus 56 bytes a
node while the levels grow.
"""

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from splatree.constants import MERGED_LOG_SCALE_MAX, SIGMAS
from splatree.errors import InputError
from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.build import thin as thin_kernel
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.lod.forest import Forest
from splatree.lod.grow_pairs import Present, grow_by_pairs
from splatree.lod.order import Level, preorder
from splatree.maths.morton import morton_codes
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import LevelRecord
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene
from splatree.scene.thinning import METHOD_FROM_OPTION, Importance, MergeOptions, Method, check_used, rules_of
from splatree.shapes import Array
from splatree.simplify.merge import check_finite, importance_of, weights_of
from splatree.simplify.thin import auto_radius, linear_colors
from splatree.simplify.visibility import pixel_size_of, visibilities_in

__all__ = ["BuildOptions", "build_lod"]

FITTED_WIDENING = 0.34
"""`pairs`: what saturated nodes are widened by, where one thinning takes 0.3: far views of a city gain 0.2 dB."""

WIDEST_PIXEL = 16.0
"""`pairs` ends with pixels so many times as wide as the scene: no change of the picture can be as large as one of them."""


@dataclass(frozen=True)
class BuildOptions:
    """How the levels grow."""

    method: Method = "radius"
    """`radius` merges what is close, by ever larger radii; `pairs` what a pixel of ever larger size does not show, for better
    pictures of fewer nodes in several times the time."""
    radius: float | Literal["auto"] = "auto"
    """`radius`: r_0, world units: radius of the first level; `auto`: 1.5 × the median distance to the nearest neighbour."""
    pixel_size: float | None = None
    """`pairs`: p_0, world units: width of a pixel for which the first level is made; None: half of the median Gaussian."""
    visibility: bool = True
    """`pairs`: what others hide counts less."""
    growth: float = 2.0
    """g: each level's radius, or size of a pixel, is g times the one before."""
    max_roots: int = 64
    """Levels end when at most this many nodes are left."""
    importance: Importance = "opacity-scale"
    """`radius`: which of two close Gaussians a group forms around: the larger `opacity`, times mean scale, or times area."""
    color_radius: float | None = 0.5
    """`radius`: ρ, the distance in linear RGB (DC colour) that counts as much as r in space; None: colour keeps nothing apart."""
    merge: MergeOptions = field(default_factory=MergeOptions)
    """How a group becomes one Gaussian."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not isinstance(self.radius, str) and not 0 < self.radius <= 1e30:
            raise InputError(f"radius: found {self.radius}, wanted more than 0 world units, finite")
        if self.pixel_size is not None and not 0 < self.pixel_size <= 1e30:
            raise InputError(f"pixel_size: found {self.pixel_size}, wanted more than 0 world units, finite")
        if not 1 < self.growth <= 1e6:
            raise InputError(f"growth: found {self.growth}, wanted more than 1 (2 doubles the radius each level)")
        if self.max_roots < 1:
            raise InputError(f"max_roots: found {self.max_roots}, wanted at least 1")
        if self.color_radius is not None and not self.color_radius > 0:
            raise InputError(
                f"color_radius: found {self.color_radius}, wanted more than 0, or none to leave colour out"
            )
        check_used(self, self.method, {**METHOD_FROM_OPTION, "radius": "radius"})


def build_lod(scene: Scene, options: BuildOptions | None = None, *, threads: int = 0) -> Scene:
    """The scene with levels of detail; its leaves are the given Gaussians bit for bit, in another order.

    Levels that the scene already has are dropped: only its leaves count. ``ids`` keep the identity of the leaves (their row,
    if the scene had none); inner nodes have new ones. Rules and counts are written to ``source.metadata["levels"]``.

    Raises:
        InputError: NaN or infinity in the Gaussians.
    """
    options = options or BuildOptions()
    leaves, leaf_ids = _leaves_of(scene)
    check_finite(leaves)
    merge = options.merge.resolved(scene.mode, growth=options.growth, of_pairs=options.method == "pairs")
    if merge.opacity == "fitted" and merge.widening is None:
        merge = dataclasses.replace(merge, widening=FITTED_WIDENING)
    options = dataclasses.replace(options, merge=merge)
    forest, diagonal = _forest_of(leaves, options), _diagonal_of(leaves)
    record = LevelRecord("radius-thinning", "exact", scene.mode, growth=options.growth, merge=merge)
    rules: dict[str, Any] = {"growth": options.growth, "max_roots": options.max_roots}
    if options.method == "pairs":
        pixel_size = options.pixel_size or 0.5 * pixel_size_of(leaves)
        visibilities = np.ones(len(leaves), np.float32)
        if options.visibility:
            visibilities = visibilities_in(scene.mode, leaves, threads=threads)[forest.leaf_from_node]
            forest.weights[0] *= visibilities
        present = Present(forest.columns[0], forest.weights[0], visibilities, scene.mode, merge)
        pixel_sizes = _steps(pixel_size, WIDEST_PIXEL * (diagonal + _largest_reach(leaves)), options.growth)
        forest = grow_by_pairs(forest, present, pixel_sizes, max_roots=options.max_roots, threads=threads)
        record = dataclasses.replace(record, rule="pairs", profile="sphere", visibility=options.visibility)
        rules |= {
            "rule": "pairs",
            "pixel_size": pixel_size,
            "pixel_sizes": forest.steps,
            "visibility": options.visibility,
        }
    else:
        radius = auto_radius(leaves, threads=threads) if isinstance(options.radius, str) else float(options.radius)
        forest = _grow(forest, options, radius, diagonal, threads)
        record = dataclasses.replace(record, importance=options.importance, color_radius=options.color_radius)
        rules |= {"rule": "radius-thinning", "radius": radius, "radii": forest.steps}
        rules |= {"importance": options.importance, "color_radius": options.color_radius}
    report = rules | {"merge": rules_of(options.merge), "mode": scene.mode, "nodes": forest.counts}
    record = dataclasses.replace(record, steps=tuple(forest.steps))
    built = _assemble(scene, leaves, leaf_ids, forest, json.dumps(report), threads)
    return dataclasses.replace(built, tree=dataclasses.replace(built.tree, record=record))


def _steps(first: float, last: float, growth: float) -> list[float]:
    num_steps = math.ceil(math.log(max(1.0, last / first), growth)) + 1
    return [first * growth**step for step in range(num_steps)]


def _largest_reach(gaussians: Gaussians) -> float:
    largest = min(float(gaussians.log_scales.max(initial=-np.inf)), MERGED_LOG_SCALE_MAX)
    return SIGMAS * math.exp(largest)


def _leaves_of(scene: Scene) -> tuple[Gaussians, Array]:
    ids = np.arange(len(scene), dtype=np.uint32) if scene.ids is None else scene.ids
    is_leaf = scene.tree.is_leaf
    if is_leaf.all():
        return scene.gaussians, ids
    return scene.gaussians.take(is_leaf), ids[is_leaf]


def _forest_of(leaves: Gaussians, options: BuildOptions) -> Forest:
    order = np.argsort(morton_codes(leaves.means), kind="stable").astype(np.int32)
    weights = weights_of(leaves, options.merge.weight or "opacity")[order]
    nodes = np.arange(len(leaves), dtype=np.int32)
    return Forest(order, [leaves.with_sh_degree(0).take(order)], [weights], [], nodes, [len(leaves)], [])


def _diagonal_of(gaussians: Gaussians) -> float:
    sides = [float(x.max()) - float(x.min()) for x in gaussians.means.T] if len(gaussians) else [0.0]
    return float(np.linalg.norm(sides))


def _grow(forest: Forest, options: BuildOptions, radius: float, diagonal: float, threads: int) -> Forest:
    present, weights, nodes = forest.columns[0], forest.weights[0], forest.roots
    color_radius = np.inf if options.color_radius is None else options.color_radius
    num_nodes = len(nodes)
    with task("build levels", float(len(nodes))) as advance:
        while len(nodes) > options.max_roots:
            groups = thin_kernel.thin(
                *(present.means, linear_colors(present), importance_of(present, options.importance)),
                radius=radius,
                color_radius=color_radius,
                threads=threads,
            )
            is_family = groups.sizes > 1
            num_families = int(is_family.sum())
            if num_families:
                advance(float(len(present) - len(groups)))
                in_family = np.repeat(is_family, groups.sizes)
                start = np.cumsum(groups.sizes[is_family]) - groups.sizes[is_family]
                forest.levels.append(Level(num_nodes, nodes[groups.rows[in_family]], start))
                merged = merge_kernel.merge(present, groups, weights, options.merge, threads=threads)
                weights = np.add.reduceat(weights[groups.rows], groups.start[:-1])
                nodes = nodes[groups.representatives]
                nodes[is_family] = np.arange(num_nodes, num_nodes + num_families, dtype=np.int32)
                num_nodes += num_families
                present = merged
                forest.columns.append(merged.take(is_family))
                forest.weights.append(weights[is_family])
                forest.counts.append(len(nodes))
                forest.steps.append(radius)
            if radius > diagonal:
                break
            radius *= options.growth
    return dataclasses.replace(forest, roots=nodes)


def _assemble(scene: Scene, leaves: Gaussians, leaf_ids: Array, forest: Forest, report: str, threads: int) -> Scene:
    means = np.concatenate([part.means for part in forest.columns])
    x, y, z = np.concatenate([part.log_scales for part in forest.columns]).T
    largest = np.maximum(np.maximum(x, y), z)  # ten times faster than the maximum along an axis of three
    with np.errstate(over="ignore"):
        reach = SIGMAS * np.exp(largest.astype(np.float64))
    order = preorder(forest.levels, forest.roots, means, reach)
    row, n, tree = order.row_from_node, len(means), order.tree
    if forest.extents:
        extents = tree.extents.copy()
        for level, extent in zip(forest.levels, forest.extents, strict=True):
            extents[row[level.parents]] = extent
        tree = dataclasses.replace(tree, extents=extents)

    node_from_row = np.empty(n, np.intp)
    node_from_row[row] = np.arange(n)

    def placed(parts: list[Array]) -> Array:
        return np.take(np.concatenate(parts), node_from_row, axis=0)

    row_from_leaf = np.empty(len(leaves), np.int32)
    row_from_leaf[forest.leaf_from_node] = row[: len(leaves)]
    leaf_from_row = np.zeros(n, np.intp)  # inner nodes take any leaf's harmonics, and then their children's mean
    leaf_from_row[row_from_leaf] = np.arange(len(leaves))
    sh = np.take(leaves.sh, leaf_from_row, axis=0)
    merge_kernel.average_children(sh, tree.subtree_end, placed(forest.weights), threads=threads)
    gaussians = Gaussians(
        placed([part.means for part in forest.columns]),
        placed([part.quats for part in forest.columns]),
        placed([part.log_scales for part in forest.columns]),
        placed([part.logit_opacities for part in forest.columns]),
        sh,
    )
    ids = np.empty(n, np.uint32)
    first_id = int(leaf_ids.max()) + 1 if len(leaf_ids) else 0
    if first_id + n - len(leaves) > 2**32:  # no room above the largest: number all rows anew
        leaf_ids, first_id = np.arange(len(leaves), dtype=np.uint32), len(leaves)
    ids[row_from_leaf] = leaf_ids
    ids[row[len(leaves) :]] = np.arange(first_id, first_id + n - len(leaves), dtype=np.uint32)
    metadata = {key: value for key, value in scene.source.metadata.items() if key != "clusters"}
    source = dataclasses.replace(scene.source, metadata={**metadata, "levels": report})
    blocks = index_blocks(gaussians, tree, threads=threads)
    return dataclasses.replace(
        scene, gaussians=gaussians, tree=tree, ids=ids, blocks=blocks, clusters=None, source=source
    )
