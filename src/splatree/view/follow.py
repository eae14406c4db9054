"""Nodes for a page as they are drawn in a view: merged ones follow the pixel (lod/follow.py), the page draws them as they come.

A page keeps a node until it leaves the cut. A node whose pixel has changed much since is sent again.
"""

import numpy as np

from splatree.kernels.reference.nodes import LOG_SCALE_MAX
from splatree.kernels.reference.project import follow
from splatree.scene.gaussians import Gaussians
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, UInt32

__all__ = ["dilations_at", "followed", "has_drifted"]

DRIFT = 1.15
"""Factor on its dilation in world units² at which a node is sent again: 7 % of its distance."""


def dilations_at(
    means: Float32[Array, "v 3"], limits: Float32[Array, "v"], view: View | None
) -> Float32[Array, "v"] | None:
    """The dilation at the depth of each node, world units², at most that of its level; None: nodes do not follow."""
    if view is None or view.mode != "classic":
        return None
    camera = view.camera
    forward = camera.camera_from_world[2]
    depths = means @ forward[:3].astype(np.float32) + np.float32(forward[3])
    dilations = np.float32(view.dilation_px2 / (camera.K[0, 0] * camera.K[1, 1])) * depths * depths
    return np.asarray(np.minimum(dilations, limits))


def has_drifted(now: Float32[Array, "v"], sent: Float32[Array, "v"]) -> Array:
    """Whether each dilation has left the one that its node was sent with; leaves have 0 and never do."""
    return np.asarray((now > DRIFT * sent) | (now * DRIFT < sent))


def followed(
    words: UInt32[Array, "v 8"],
    gaussians: Gaussians,
    curves: Float32[Array, "n 4"],
    rows: Int32[Array, "v"],
    dilations: Float32[Array, "v"],
) -> UInt32[Array, "v 8"]:
    """Packed nodes (kernels/reference/nodes.py) with the scales and opacities that they are drawn with."""
    at = np.flatnonzero(curves[rows, 2] > 0)
    chosen = rows[at]
    given = np.exp(gaussians.log_scales[chosen].astype(np.float64))
    scales, opacities = follow(
        curves[chosen].astype(np.float64), dilations[at].astype(np.float64), given, np.ones(len(at))
    )
    shares = np.clip(np.log(np.maximum(scales, 1e-30)) / LOG_SCALE_MAX, -1, 1)
    codes = np.rint((shares + 1) * 32767.5).astype(np.uint32)
    words[at, 3] = (words[at, 3] & np.uint32(0xFFFF)) | np.rint(65535 * opacities).astype(np.uint32) << np.uint32(16)
    words[at, 6] = (words[at, 6] & np.uint32(0xFFFF)) | codes[:, 0] << np.uint32(16)
    words[at, 7] = codes[:, 1] | codes[:, 2] << np.uint32(16)
    return words
