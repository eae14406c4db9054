"""Let merged Gaussians follow the pixel that they are drawn at: what a node shows near by is not what it shows far away.

In mode `classic` each splat grows by 0.3 px². At a depth where a pixel is p wide this adds h = 0.3 p² to variances. The leaves
of a node show, at that depth, the mass

    M(h) = Σ α A(h),     A(h) = (√((a+h)(b+h)) + √((b+h)(c+h)) + √((a+h)(c+h))) / 3

over leaves with variances a, b, c along their axes. A is the area of a Gaussian, averaged over views along its axes. A node with
the moments of its leaves shows the same mass with the opacity ρ = M / A_node. It is small near by, where gaps are seen between
the leaves, and large far away, where they overlap. What others hide counts less: ρ_v has α v in the place of α, where v is the
visibility of a leaf (simplify/visibility.py), and the node gets the mass G = √(ρ ρ_v). Mass beyond one Gaussian widens the splat
with its dilation: its variance becomes w (v + h), w = max(1, G / 0.99)^0.3, so that of the node w v + (w − 1) h.

A node is *stored* as it is drawn at a pixel h_l: four times as wide as the one from which on it is drawn at τ_R = 3 px, and by
pairs at least eight times the median Gaussian, by a radius at least 4 r_0. Far views with generous budgets draw levels where the
pixel is wider than their own. Nearer than h_l a node is drawn with less: `GaussianTree.curves` keeps m = M(0),
n = M'(∞), g = G(h_l) and h_l, from which G follows at any h by a closed form. It is exact at 0, at h_l and far away
(kernels/reference/project.py):

    G(h) = √(m² + b h + (n h)²) / A_node(h),     b such that G(h_l) = g

Farther than that it is drawn as stored. So what is drawn is never larger or more opaque than what is stored, and all tests of
what can be seen hold as they are.

Nodes of the finest levels by pairs stand for few leaves that are nearly one Gaussian. They keep the Gaussian of their merge. Its
opacity α is the one that fits best at the pixel p_0, and G is scaled so that G(0.3 p_0²) = α: up to 1 dB nearer to the leaves (a
city at 80 %).

Cost: 0.6 CPU-seconds a million leaves. Memory: 16 bytes a node.
"""

import dataclasses

import numpy as np

from splatree.constants import DILATION_PX2, PIXEL_ERROR
from splatree.kernels.cpu.build.curves import fit_curves
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Float64

__all__ = ["STORED_SHARE", "dilations_of_extents", "kept_extent", "least_dilation", "with_curves"]

WIDER = 4.0
"""Nodes are stored for a pixel so many times as wide as that of their level: a far view with a generous budget draws them there
(τ_R = ¾ px). By pairs, a city at 20 % gains 1.5 dB from outside and 4 dB from afar."""

STORED_SHARE = DILATION_PX2 * (WIDER / PIXEL_ERROR) ** 2
"""h_l as a share of a node's extent²."""


def kept_extent(judged: float) -> float:
    """The largest extent of nodes by pairs that keep their Gaussian, given the pixel p_0; world units."""
    return PIXEL_ERROR * judged * (1 + 1e-6)


def least_dilation(stored: float) -> float:
    """The least h_l, world units², given the finest pixel that nodes are stored for, world units."""
    return max(DILATION_PX2 * stored**2, 1e-30)


def dilations_of_extents(extents: Float32[Array, "n"], stored: float) -> Float64[Array, "n"]:
    """h_l of nodes, world units², given the finest pixel that nodes are stored for, world units."""
    return np.maximum(STORED_SHARE * extents.astype(np.float64) ** 2, least_dilation(stored))


def with_curves(
    gaussians: Gaussians,
    tree: GaussianTree,
    seen: Float32[Array, "n"],
    *,
    pixels: tuple[float, float] = (0.0, 0.0),
    threads: int = 0,
) -> tuple[Gaussians, GaussianTree]:
    """The rows of a scene of mode `classic`, with inner nodes that follow the pixel they are drawn at.

    Args:
        gaussians: the rows; leaves stay bit for bit.
        tree: the levels.
        seen: visibility of each row, 0 to 1; those of leaves count.
        pixels: world units: the pixel p_0 at which fine levels by pairs were judged, whose nodes keep their Gaussian; and the
            finest pixel that nodes are stored for.
        threads: threads to use; 0: all.

    Returns:
        The Gaussians with other means, shapes and opacities of inner nodes, and the tree with their curves.

    Source:
        The sums are exact moments of mixtures; the closed form of M was found by measurement (docs/explanation/build.md).
    """
    judged, stored = pixels
    followed, curves = fit_curves(
        *(gaussians, tree.subtree_end, seen, STORED_SHARE, tree.extents),
        kept_extent=kept_extent(judged),
        kept_dilation=DILATION_PX2 * judged**2,
        least_dilation=least_dilation(stored),
        threads=threads,
    )
    return followed, dataclasses.replace(tree, curves=curves)
