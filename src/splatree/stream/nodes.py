"""Nodes of a level as they are drawn from nearer than they are stored for.

A tree stores its nodes as they look where they are three pixels large. A viewer with a budget draws them larger, by the file's
values alone. So the file gets what the library itself would draw there (lod/follow.py). The first coarser level is expected at
``node_px``, and each coarser one larger by √2 for each halving of its nodes: the fewer nodes a budget allows, the larger they are
drawn. On five scenes this is 0.5 to 6 dB nearer to the leaves, near and far, than nodes with an opacity of their own alone; one
pixel size for all levels loses 2 dB where few nodes are drawn, and one dilation for all of them loses 2 dB from afar.
"""

import dataclasses
import math

import numpy as np

from splatree.constants import ALPHA_MAX, DILATION_PX2
from splatree.kernels.reference.project import follow
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.stream.levels import Level

__all__ = ["gaussians_of_level"]

_SCALE_MIN = 1e-12
"""The least scale that the build stores, world units."""


def gaussians_of_level(scene: Scene, level: Level, rows: Array, node_px: float) -> Gaussians:
    """``rows`` of a level as they are drawn where they are expected; 0: as they are stored.

    Leaves stay bit for bit. So do nodes that do not follow the pixel: in mode `antialiased`, and in trees without curves.
    """
    g = scene.gaussians.take(rows)
    if scene.tree.curves is None or scene.mode != "classic" or node_px == 0:
        return g
    curves = scene.tree.curves[rows].astype(np.float64)
    drawn_px = node_px * math.sqrt(scene.tree.num_leaves / (2 * len(level)))
    dilation = DILATION_PX2 * (level.size / drawn_px) ** 2
    at = np.flatnonzero((curves[:, 2] > 0) & (dilation < curves[:, 3]))  # beyond its own a node is drawn as stored
    log_scales, logits = g.log_scales.copy(), g.logit_opacities.copy()
    given = np.exp(log_scales[at].astype(np.float64))
    scales, opacities = follow(curves[at], np.full(len(at), dilation), given, np.ones(len(at)))
    opacities = np.clip(opacities, 1e-6, ALPHA_MAX)
    log_scales[at] = np.log(np.maximum(scales, _SCALE_MIN))
    logits[at] = np.log(opacities) - np.log1p(-opacities)
    return dataclasses.replace(g, log_scales=log_scales, logit_opacities=logits)
