"""Let merged Gaussians follow the pixel that they are drawn at: what a node shows near by is not what it shows far away.

In mode `classic` each splat grows by 0.3 px². At a depth where a pixel is p wide this adds h = 0.3 p² to variances. The leaves
of a node show, at that depth, the mass

    M(h) = Σ α A(h),     A(h) = (√((a+h)(b+h)) + √((b+h)(c+h)) + √((a+h)(c+h))) / 3

over leaves with variances a, b, c along their axes. A is the area of a Gaussian, averaged over views along its axes. A node with
the moments of its leaves shows the same mass with the opacity ρ = M / A_node. It is small near by, where gaps are seen between
the leaves, and large far away, where they overlap. What others hide counts less: ρ_v has α v in the place of α, where v is the
visibility of a leaf (simplify/visibility.py), and the node gets the mass G = √(ρ ρ_v). Mass beyond one Gaussian widens the splat
with its dilation: its variance becomes w (v + h), w = max(1, G / 0.99)^0.3, so that of the node w v + (w − 1) h.

A node is *stored* as it is drawn at the pixel that its level was made for, h_l. Viewers that know nothing of the rest draw this,
and every file format holds it. Nearer than that it is drawn with less: `GaussianTree.curves` keeps m = M(0), n = M'(∞),
g = G(h_l) and h_l, from which G follows at any h by a closed form. It is exact at 0, at h_l and far away
(kernels/reference/project.py):

    G(h) = √(m² + b h + (n h)²) / A_node(h),     b such that G(h_l) = g

Farther than that it is drawn as stored. So what is drawn is never larger or more opaque than what is stored, and all tests of
what can be seen hold as they are.

Cost: about 4 CPU-seconds a million leaves. Memory: 16 bytes a node.
"""

import dataclasses

import numpy as np

from splatree.constants import ALPHA_MAX, DILATION_PX2, MERGED_LOG_SCALE_MAX, PIXEL_ERROR, SIGMAS
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.forests import subtree_radii
from splatree.maths.mixtures import LeafSums, areas
from splatree.maths.rotations import quats_from_matrices
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64
from splatree.simplify.visibility import visibilities_in

__all__ = ["with_curves"]

LEAST_VARIANCE = 1e-24
"""Variances below this, world units², are taken for it: a logarithm is taken of them."""
LARGEST = 1e15
"""Areas beyond this, world units², are no longer told apart in float32, whose squares end at 1e38."""
STEPS_PER_OCTAVE = 2
"""h_l is taken in steps of √2, so that masses are summed for a few of its values and not for each node's own."""


def with_curves(scene: Scene, *, visibility: bool = True, threads: int = 0) -> Scene:
    """The scene with inner nodes that follow the pixel they are drawn at.

    Args:
        scene: a scene of mode `classic` with levels. Leaves stay bit for bit.
        visibility: whether what others hide counts less.
        threads: threads to use; 0: all.

    Returns:
        The scene with other means, shapes and opacities of inner nodes, and with `GaussianTree.curves`.

    Source:
        The sums are exact moments of mixtures; the closed form of M was found by measurement (docs/explanation/build.md).
    """
    tree, g = scene.tree, scene.gaussians
    is_leaf = tree.is_leaf
    leaves = g.take(is_leaf)
    alphas = leaves.opacities()
    seen = np.ones(len(leaves))
    if visibility:
        seen = visibilities_in(scene.mode, leaves, threads=threads).astype(np.float64)
    sums = LeafSums(tree.subtree_end, tree.depth)
    weights = np.maximum(alphas * seen, 1e-12)
    means, covariances = sums.moments(
        weights, leaves.means, covariances_from_gaussians(leaves.quats, leaves.log_scales)
    )
    inner = np.flatnonzero(~is_leaf)
    variances, axes = np.linalg.eigh(covariances[inner])
    variances = np.maximum(variances, LEAST_VARIANCE)

    steps = np.rint(STEPS_PER_OCTAVE * np.log2(_level_dilations(scene, inner, variances))).astype(np.int64)
    dilations = 2.0 ** (steps / STEPS_PER_OCTAVE)
    leaf_variances = np.exp(2 * np.minimum(leaves.log_scales, MERGED_LOG_SCALE_MAX).astype(np.float64))
    far, bare, shown = (
        np.sqrt(a * b)  # √(ρ ρ_v), times areas
        for a, b in zip(
            *(sums.masses(inner, each, leaf_variances, dilations) for each in (alphas, weights)), strict=True
        )
    )
    peak = shown / areas(variances, dilations)  # G(h_l)
    wide = np.maximum(peak / ALPHA_MAX, 1) ** 0.3
    stored = wide[:, None] * variances + ((wide - 1) * dilations)[:, None]
    numbers = np.stack([bare, far, peak, dilations], axis=1)
    numbers[~(numbers < LARGEST).all(axis=1)] = 0  # nodes of absurd sizes are drawn as stored
    new = np.zeros((len(g), 4), np.float32)
    new[inner] = numbers

    opacities = np.clip(peak, 1e-6, ALPHA_MAX)
    columns = {name: getattr(g, name).copy() for name in ("means", "quats", "log_scales", "logit_opacities")}
    columns["means"][inner] = means[inner]
    columns["quats"][inner] = quats_from_matrices(_right_handed(axes))
    columns["log_scales"][inner] = np.minimum(0.5 * np.log(stored), MERGED_LOG_SCALE_MAX)
    columns["logit_opacities"][inner] = np.log(opacities) - np.log1p(-opacities)
    gaussians = Gaussians(**columns, sh=g.sh)
    extents = tree.extents
    if tree.record is None or tree.record.profile != "sphere":  # balls that hold all that is below
        extents = subtree_radii(gaussians.means, gaussians.reach(), tree.depth)
    followed = dataclasses.replace(tree, curves=new, extents=extents)
    return dataclasses.replace(scene, gaussians=gaussians, tree=followed, blocks=None, clusters=None)


def _level_dilations(scene: Scene, inner: Array, variances: Array) -> Float64[Array, "i"]:
    """h_l of each inner node: at the pixel of its level, or for levels by a radius where its 3σ are the pixel error, τ_R."""
    record = scene.tree.record
    if record is not None and record.profile == "sphere":
        pixels = scene.tree.extents[inner].astype(np.float64) / PIXEL_ERROR
        return np.asarray(np.maximum(DILATION_PX2 * pixels**2, 1e-30))
    growth = 1.0 if record is None else record.growth or 1.0
    drawn_px2 = (PIXEL_ERROR / SIGMAS) ** 2
    return np.asarray(DILATION_PX2 * growth / (drawn_px2 - DILATION_PX2) * variances.max(axis=1))


def _right_handed(axes: Float64[Array, "n 3 3"]) -> Float64[Array, "n 3 3"]:
    """Rotations: eigenvectors are turned to a right-handed frame."""
    turned = axes.copy()
    turned[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    return turned
