"""Opacities of a level that is looked at from nearer than its nodes were made for.

A merged node is made for the distance at which its extent is three pixels. There the 0.3 px² that classic drawing adds to each
variance make its leaves wider, they cover more, and the node's opacity says so. A viewer with a budget draws nodes larger than
that: the same opacity then covers too much, and the picture is too bright and its silhouettes too wide.

What the leaves below a node cover is in proportion to Σ αᵢ A(Σᵢ + h I), where A is the mean area of an ellipsoid's projections,
and h = 0.3 p² is the dilation where a pixel is p wide in the world. What the node covers is α A(Σ + h I). So with

    ρ(h) = Σᵢ αᵢ A(Σᵢ + h I) / A(Σ + h I)

its opacity becomes α ρ(h_drawn) / ρ(h_made). Leaves keep theirs, and so do all nodes of antialiased scenes, whose drawing takes
back what the dilation adds. Over the levels of trained scenes this is worth 2 to 3 dB for nodes that are drawn 6 to 20 pixels
large, and costs 1 to 2 dB where they are smaller than three.
"""

import numpy as np

from splatree.constants import DILATION_PX2
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32
from splatree.stream.levels import Level

__all__ = ["MADE_FOR_PX", "logits_of_level"]

MADE_FOR_PX = 3.0
"""Extent of a node, in pixels, at the distance that it was made for."""

_OPACITY_MAX = 0.999


def logits_of_level(scene: Scene, level: Level, rows: Array, drawn_px: float) -> Float32[Array, "v"]:
    """Logit opacities of ``rows``, those of whole chunks of a level, for nodes drawn when their extents are ``drawn_px``."""
    g, end = scene.gaussians, scene.tree.subtree_end
    logits = g.logit_opacities[rows]
    is_node = end[rows] > rows + 1
    if scene.mode != "classic" or drawn_px == MADE_FOR_PX or not is_node.any():
        return logits
    nodes = rows[is_node]
    span = np.arange(rows[0], end[rows[-1]])
    leaves = span[end[span] == span + 1]
    owners = rows[
        np.searchsorted(rows, leaves, side="right") - 1
    ]  # the rows of a level share all leaves of their chunks
    is_below = owners != leaves
    leaves, owner = leaves[is_below], np.searchsorted(nodes, owners[is_below])
    made = DILATION_PX2 * (scene.tree.extents[nodes].astype(np.float64) / MADE_FOR_PX) ** 2
    drawn = np.full(len(nodes), DILATION_PX2 * (level.size / drawn_px) ** 2)
    of_nodes, of_leaves = g.take(nodes), g.take(leaves)
    alphas, variances, node_variances = of_leaves.opacities(), of_leaves.scales() ** 2, of_nodes.scales() ** 2

    def coverage(h: Array) -> Array:
        covered = np.bincount(owner, alphas * _mean_areas(variances + h[owner, None]), len(nodes))
        return np.asarray(covered / _mean_areas(node_variances + h[:, None]))

    opacities = np.minimum(of_nodes.opacities() * coverage(drawn) / coverage(made), _OPACITY_MAX)
    logits[is_node] = np.log(opacities) - np.log1p(-opacities)
    return logits


def _mean_areas(variances: Array) -> Array:
    """Mean area of the projections of ellipsoids, up to a factor, within a few per cent: a mean of their principal sections."""
    x, y, z = np.sqrt(variances).T
    return np.asarray(x * y + y * z + z * x)
