"""Nodes of a stream as they are drawn from nearer than they are stored for.

A tree stores its nodes as they look where they are three pixels large. A viewer with a budget draws them larger, by the file's
values alone. So the file gets what the library itself would draw there (lod/follow.py). A cut of half as many nodes as leaves is
expected at ``node_px``, and a smaller one larger by √2 for each halving of its nodes: the fewer nodes a budget allows, the larger
they are drawn.

PlayCanvas chooses levels of whole chunks, and spends half of its budget on chunks outside a near view: its nodes are large on the
screen. At 12 px, near views of 50,000 nodes come 0.7 dB nearer to the leaves than at 8 px, on two scenes, and middle ones 0.3 dB;
far views, which are at 32 to 40 dB anyway, come up to 0.9 dB less near. The engine itself in a browser agrees for near and middle
views in windows of 1600 × 900 pixels (0.6 and 0.3 dB nearer). It widens splats less than the library
(readers/playcanvas_drawing.py). Nodes do not make up for that: wider ones are too wide where a page has set the usual dilation.
One pixel size for all levels loses 2 dB where few nodes are drawn, and one dilation for all of them loses 2 dB
from afar.

Spark chooses single nodes by their size, so they are drawn smaller. At 4 px, views of 100,000 nodes of two scenes come 6 to 14 dB
nearer than with nodes as stored. A node that is right at 4 px is too transparent at 1 px, at which Spark draws all nodes if its
budget is not used up: a far view of a piece of a city then loses 10 dB, at 35 dB. At 3 px far views gain and near ones lose
a decibel (benchmarks/streams.py, docs/how-to/publish-a-stream.md).
"""

import dataclasses

import numpy as np

from splatree.constants import ALPHA_MAX, DILATION_PX2
from splatree.io.memory import Scratch
from splatree.kernels.reference.project import follow
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.stream.levels import Level, cuts_of, intervals_of

__all__ = ["gaussians_of_level", "gaussians_of_tree"]

_SCALE_MIN = 1e-12
"""The least scale that the build stores, world units."""


def gaussians_of_level(scene: Scene, level: Level, rows: Array, node_px: float) -> Gaussians:
    """``rows`` of a level as they are drawn where they are expected; 0: as they are stored.

    Leaves stay bit for bit. So do nodes that do not follow the pixel: in mode `antialiased`, and in trees without curves.
    """
    if not _follows(scene, node_px):
        return scene.gaussians.take(rows)
    assert scene.tree.curves is not None
    dilations = np.full(len(rows), _dilation(scene, level.size, len(level), node_px))
    g = scene.gaussians.take(rows)
    log_scales, logits = _drawn(g, scene.tree.curves[rows], dilations)
    return dataclasses.replace(g, log_scales=log_scales, logit_opacities=logits)


def gaussians_of_tree(scene: Scene, node_px: float, scratch: Scratch | None = None) -> Gaussians:
    """All rows of the tree, each as a cut at its own size would have it, in arrays of ``scratch``; 0: as they are stored."""
    if not _follows(scene, node_px):
        return scene.gaussians
    tree, scratch = scene.tree, scratch or Scratch.endless()
    intervals = intervals_of(tree, scratch=scratch.part(0.25))
    sizes, counts = cuts_of(intervals, scratch.part(0.25))
    g, curves = scene.gaussians, tree.curves
    assert curves is not None
    log_scales, logits = scratch.zeros((len(tree), 3), np.float32), scratch.zeros((len(tree),), np.float32)
    for run, from_sizes, _ in intervals.runs():
        at = np.maximum(np.searchsorted(sizes, from_sizes, side="right") - 1, 0)
        dilations = _dilation(scene, from_sizes, counts[at], node_px)
        log_scales[run], logits[run] = _drawn(g.rows(run.start, run.stop), curves[run], dilations)
    return dataclasses.replace(g, log_scales=log_scales, logit_opacities=logits)


def _follows(scene: Scene, node_px: float) -> bool:
    return scene.tree.curves is not None and scene.mode == "classic" and node_px > 0


def _dilation(scene: Scene, size: Array | float, num_nodes: Array | int, node_px: float) -> Array:
    """h, world units², where a cut of so many nodes at this size is expected."""
    drawn_px = node_px * np.sqrt(scene.tree.num_leaves / (2 * np.asarray(num_nodes, np.float64)))
    return np.asarray(DILATION_PX2 * (size / drawn_px) ** 2)


def _drawn(g: Gaussians, curves: Array, dilations: Array) -> tuple[Array, Array]:
    """Log-scales and logit opacities of nodes as the library draws them at these dilations."""
    curves = curves.astype(np.float64)
    at = np.flatnonzero((curves[:, 2] > 0) & (dilations < curves[:, 3]))  # beyond its own a node is drawn as stored
    log_scales, logits = g.log_scales.copy(), g.logit_opacities.copy()
    given = np.exp(log_scales[at].astype(np.float64))
    scales, opacities = follow(curves[at], dilations[at], given, np.ones(len(at)))
    opacities = np.clip(opacities, 1e-6, ALPHA_MAX)
    log_scales[at] = np.log(np.maximum(scales, _SCALE_MIN))
    logits[at] = np.log(opacities) - np.log1p(-opacities)
    return log_scales, logits
