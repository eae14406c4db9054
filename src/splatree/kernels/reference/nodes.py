"""A node in 32 bytes, as the viewer's page draws it: the definition.

Eight words of 32 bits a node:

::

    0-2  mean, float32, relative to a centre
    3    bits 0-1 which component of the quaternion is left out, 8-14 depth in the tree, 15 is a leaf, 16-31 opacity / 65535
    4    colour seen from the eye: red 11 bits, green 11, blue 10, of 0 to 2
    5-7  the three smaller components of the quaternion, of ±1/√2, then the logarithms of the three scales, of ±20; 16 bits each

The rotation is kept instead of a covariance: the half-precision covariance of a thin splat of 500 px would be wrong by ten
pixels across, the rotation turns it by less than a twentieth of a pixel.
"""

import numpy as np

from splatree.kernels.reference.project import follow
from splatree.maths.harmonics import colors_from_harmonics
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Float64, Int32, UInt8, UInt32

__all__ = [
    "COLOR_MAX",
    "LOG_SCALE_MAX",
    "NODE_WORDS",
    "pack_colors",
    "pack_nodes",
    "pack_shapes",
    "unpack_nodes",
    "with_depths",
]

NODE_WORDS = 8
"""Words of a node."""

LOG_SCALE_MAX = 20.0
"""Logarithms of scales are kept from minus to plus this, in steps of 0.06 %."""

COLOR_MAX = 2.0
"""Colours are kept from 0 to this: the sum of a node's harmonics may be brighter than white."""

_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""The components of a quaternion that are kept where each one is left out."""


def pack_nodes(
    gaussians: Gaussians,
    tree: GaussianTree,
    rows: Int32[Array, "v"],
    eye: Float64[Array, "3"],
    centre: Float64[Array, "3"],
    dilations: Float32[Array, "v"] | None = None,
) -> UInt32[Array, "v 8"]:
    """The rows as words; colours are seen from ``eye``, means relative to ``centre``, world units.

    With ``dilations``, world units², merged rows have the scales and the opacity with which they are drawn at these
    (lod/follow.py); without, as they are stored.
    """
    g = gaussians.take(rows)
    words = np.empty((len(rows), NODE_WORDS), np.uint32)
    words[:, 0:3] = (g.means - centre).astype(np.float32).view(np.uint32)

    quats = g.quats.astype(np.float64)
    quats /= np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-37)
    largest = np.abs(quats).argmax(axis=1)
    sign = np.where(np.take_along_axis(quats, largest[:, None], 1) < 0, -1.0, 1.0)  # q and −q turn alike
    kept = sign * np.take_along_axis(quats, _OTHERS[largest], 1)
    small = np.rint(kept * (32767 * np.sqrt(2))).astype(np.int64) & 0xFFFF
    log_scales, opacities = (
        g.log_scales.astype(np.float64),
        0.5 * (1 + np.tanh(0.5 * g.logit_opacities.astype(np.float64))),
    )
    if dilations is not None and tree.curves is not None:
        curves = tree.curves[rows].astype(np.float64)
        drawn, opacities = follow(curves, dilations.astype(np.float64), np.exp(log_scales), opacities)
        log_scales = np.where(curves[:, 2:3] > 0, np.log(np.maximum(drawn, 1e-30)), log_scales)
    shares = np.clip(log_scales / LOG_SCALE_MAX, -1, 1)
    scales = np.rint((shares + 1) * 32767.5).astype(np.int64)
    words[:, 5] = small[:, 0] | small[:, 1] << 16
    words[:, 6] = small[:, 2] | scales[:, 0] << 16
    words[:, 7] = scales[:, 1] | scales[:, 2] << 16

    depth = np.minimum(tree.depth[rows], 127).astype(np.int64)
    leaf = (tree.subtree_end[rows] == rows + 1).astype(np.int64)
    opacity = np.rint(65535 * opacities).astype(np.int64)
    words[:, 3] = largest | depth << 8 | leaf << 15 | opacity << 16
    words[:, 4] = pack_colors(gaussians, rows, eye)
    return words


def with_depths(words: UInt32[Array, "v 8"], depths: UInt8[Array, "v"]) -> None:
    """Put depths in the tree in the place of those that packed nodes have, which may count from a row within it."""
    words[:, 3] = (words[:, 3] & np.uint32(~np.uint32(0x7F00))) | np.minimum(depths, 127).astype(
        np.uint32
    ) << np.uint32(8)


def pack_colors(gaussians: Gaussians, rows: Int32[Array, "v"], eye: Float64[Array, "3"]) -> UInt32[Array, "v"]:
    """The colours of rows seen from ``eye``, a word each."""
    directions = gaussians.means[rows] - eye
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-37)
    colors = colors_from_harmonics(gaussians.sh[rows], directions, gaussians.sh_degree)
    shares = np.clip(colors / COLOR_MAX, 0, 1)
    red, green, blue = np.rint(shares.T * np.array([[2047], [2047], [1023]])).astype(np.uint32)
    return np.asarray(red | green << 11 | blue << 22)


def pack_shapes(
    gaussians: Gaussians, tree: GaussianTree, rows: Int32[Array, "v"], dilations: Float32[Array, "v"]
) -> UInt32[Array, "v 2"]:
    """Opacity and scales of rows as they are drawn at ``dilations``, world units², with the 16 bits that nodes have of them."""
    words = pack_nodes(gaussians, tree, rows, np.zeros(3), np.zeros(3), dilations)
    return np.stack([words[:, 3] >> 16 | words[:, 6] & np.uint32(0xFFFF0000), words[:, 7]], axis=1)


def unpack_nodes(words: UInt32[Array, "v 8"]) -> dict[str, Array]:
    """What the page reads out of the words."""
    largest, level = words[:, 3] & 3, words[:, 3] >> 8 & 0xFF
    halves = words[:, 5:8].copy().view(np.uint16).reshape(-1, 6)
    small = halves[:, :3].copy().view(np.int16) / (32767 * np.sqrt(2))
    quats = np.zeros((len(words), 4))
    np.put_along_axis(quats, _OTHERS[largest], small, axis=1)
    rest = np.sqrt(np.maximum(1 - (small**2).sum(axis=1), 0))
    np.put_along_axis(quats, largest.astype(np.int64)[:, None], rest[:, None], axis=1)
    colors = np.stack([words[:, 4] & 2047, words[:, 4] >> 11 & 2047, words[:, 4] >> 22], 1)
    return {
        "means": words[:, 0:3].copy().view(np.float32),
        "quats": quats,
        "log_scales": (halves[:, 3:] / 32767.5 - 1) * LOG_SCALE_MAX,
        "opacities": (words[:, 3] >> 16) / 65535,
        "colors": colors / np.array([2047, 2047, 1023]) * COLOR_MAX,
        "depth": level & 127,
        "is_leaf": level >= 128,
    }
