"""A node in 32 bytes, as the page draws it: eight words of 32 bits.

::

    0-2  mean, float32, relative to the centre of the scene
    3    bits 0-1 which component of the quaternion is left out, 8-14 depth in the tree, 15 is a leaf, 16-31 opacity / 65535
    4    colour seen from the eye: red 11 bits, green 11, blue 10, of 0 to 2
    5-7  the three smaller components of the quaternion, then the logarithms of the three scales, 16 bits each

The rotation is kept instead of a covariance: the half-precision covariance of a thin splat of 500 px would be wrong by ten
pixels across, the rotation turns it by less than a twentieth of a pixel. Cost: about 0.6 µs a node with harmonics of degree 3.
"""

import numpy as np

from splatree.maths.harmonics import colors_from_harmonics
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64, Int32, UInt32

__all__ = ["LOG_SCALE_MAX", "NODE_WORDS", "pack_colors", "pack_nodes", "unpack_nodes"]

NODE_WORDS = 8
"""Words of a node."""

LOG_SCALE_MAX = 20.0
"""Logarithms of scales are kept from minus to plus this, in steps of 0.06 %."""

COLOR_MAX = 2.0
"""Colours are kept from 0 to this: the sum of a node's harmonics may be brighter than white."""

_QUAT_STEP = 32767 * np.sqrt(2)
"""A smaller component of a unit quaternion is at most 1 / √2."""


def pack_nodes(
    scene: Scene, rows: Int32[Array, "v"], eye: Float64[Array, "3"], centre: Float64[Array, "3"]
) -> UInt32[Array, "v 8"]:
    """The rows of a scene as words.

    Args:
        scene: where the rows are from.
        rows: rows of the scene.
        eye: where their colours are seen from, world units.
        centre: what the means are relative to, world units.
    """
    g = scene.gaussians
    words = np.empty((len(rows), NODE_WORDS), np.uint32)
    words[:, 0:3] = (g.means[rows] - centre).astype(np.float32).view(np.uint32)

    quats = g.quats[rows].astype(np.float64)
    quats /= np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-37)
    largest = np.abs(quats).argmax(axis=1)
    sign = np.where(np.take_along_axis(quats, largest[:, None], 1) < 0, -1.0, 1.0)  # q and -q turn alike
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    small = np.rint(sign * np.take_along_axis(quats, others, 1) * _QUAT_STEP).astype(np.int64) & 0xFFFF
    shares = np.clip(g.log_scales[rows] / LOG_SCALE_MAX, -1, 1)
    scales = np.rint((shares + 1) * 32767.5).astype(np.int64)
    words[:, 5] = small[:, 0] | small[:, 1] << 16
    words[:, 6] = small[:, 2] | scales[:, 0] << 16
    words[:, 7] = scales[:, 1] | scales[:, 2] << 16

    depth = np.minimum(scene.tree.depth[rows], 127).astype(np.int64)
    leaf = (scene.tree.subtree_end[rows] == rows + 1).astype(np.int64)
    opacity = np.rint(65535 * 0.5 * (1 + np.tanh(0.5 * g.logit_opacities[rows].astype(np.float64)))).astype(np.int64)
    words[:, 3] = largest | depth << 8 | leaf << 15 | opacity << 16
    words[:, 4] = pack_colors(scene, rows, eye)
    return words


def pack_colors(scene: Scene, rows: Int32[Array, "v"], eye: Float64[Array, "3"]) -> UInt32[Array, "v"]:
    """The colours of rows seen from the eye, a word each."""
    g = scene.gaussians
    sh = g.sh[rows]
    directions = np.zeros((len(rows), 3))
    if g.sh_degree:
        directions = g.means[rows] - eye
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-37)
    colors = np.clip(colors_from_harmonics(sh, directions, g.sh_degree) / COLOR_MAX, 0, 1)
    red, green, blue = np.rint(colors.T * np.array([[2047], [2047], [1023]])).astype(np.uint32)
    return np.asarray(red | green << 11 | blue << 22)


def unpack_nodes(words: UInt32[Array, "v 8"]) -> dict[str, Array]:
    """What the page reads out of the words: the definition of page/shaders.js, for tests."""
    largest, level = words[:, 3] & 3, words[:, 3] >> 8 & 0xFF
    halves = words[:, 5:8].copy().view(np.uint16).reshape(-1, 6)
    small = halves[:, :3].view(np.int16) / _QUAT_STEP
    quats = np.zeros((len(words), 4))
    for i, others in enumerate(([1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2])):
        rows = np.flatnonzero(largest == i)
        quats[rows[:, None], others] = small[rows]
        quats[rows, i] = np.sqrt(np.maximum(1 - (small[rows] ** 2).sum(1), 0))
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
