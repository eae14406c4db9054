"""Nodes in 32 bytes, natively; kernels/reference/nodes.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.reference.nodes import NODE_WORDS
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Float64, Int32, UInt32

__all__ = ["pack_colors", "pack_nodes", "pack_shapes"]


def pack_nodes(
    gaussians: Gaussians,
    tree: GaussianTree,
    rows: Int32[Array, "v"],
    eye: Float64[Array, "3"],
    centre: Float64[Array, "3"],
    dilations: Float32[Array, "v"] | None = None,
) -> UInt32[Array, "v 8"]:
    """The rows as words; colours are seen from ``eye``, means relative to ``centre``, world units; merged rows as they are
    drawn at ``dilations``, world units², or as they are stored."""
    out = np.empty((len(rows), NODE_WORDS), np.uint32)
    curves = None if dilations is None else tree.curves
    _core.pack_nodes(gaussians, tree, curves, np.ascontiguousarray(rows), dilations, eye, centre, out)
    return out


def pack_shapes(
    gaussians: Gaussians, tree: GaussianTree, rows: Int32[Array, "v"], dilations: Float32[Array, "v"]
) -> UInt32[Array, "v 2"]:
    """Opacity and scales of rows of a tree with curves as they are drawn at ``dilations``, world units², in halves of words."""
    assert tree.curves is not None
    out = np.empty((len(rows), 2), np.uint32)
    _core.pack_shapes(gaussians, tree, tree.curves, np.ascontiguousarray(rows), dilations, out)
    return out


def pack_colors(gaussians: Gaussians, rows: Int32[Array, "v"], eye: Float64[Array, "3"]) -> UInt32[Array, "v"]:
    """The colours of rows seen from ``eye``, a word each."""
    out = np.empty(len(rows), np.uint32)
    _core.pack_colors(gaussians, np.ascontiguousarray(rows), eye, out)
    return out
