"""Sketch a cut: a small picture of what its merged nodes leave out.

A merged node shows one colour where its leaves have many. Let v be the variance of the leaves' colours below a node, summed over
red, green and blue, each leaf by its opacity times σ₁ σ₂ of its two larger axes. The sketch draws the nodes of a cut with v and 1
in place of red and green, 0 for leaves, in an eighth of the picture's size. The renderer's own blend then says what is hidden:

- *varied*, the mean of red: how much the colours vary that merged nodes stand for, in the picture;
- *merged*, the mean of green: the share of the picture that merged nodes are.

Subtrees are ranges of rows, so sums over leaves are differences of running sums. Cost: 0.3 CPU-seconds a million rows once a
scene; a sketch costs the projection and the lists of a frame, and 1/64 of its pixels: about a quarter of a frame of 1080p.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.constants import SH_C0
from splatree.kernels.cpu.frame import stages
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Float64

__all__ = ["SKETCH_PX", "Sketch", "Sketcher", "color_variances"]

SKETCH_PX: Final = 8
"""Width of a sketch's pixel, px: finer ones change no prediction (a trial with 4)."""

BLACK: Final = np.float32(-4.0)
"""Below the coefficient of black, so that no rounding is left of it: colours are held above 0."""

LARGEST_WEIGHT: Final = 1e6
"""Leaves larger than the median by more than this count for it: running sums then keep the small ones."""


@dataclass(frozen=True)
class Sketch:
    """What the merged nodes of a cut leave out of a view."""

    merged: float
    """Share of the picture that merged nodes are."""
    varied: float
    """Variance of colours within merged nodes, a mean over the picture."""


@dataclass(frozen=True, eq=False)
class Sketcher:
    """Draws sketches of the cuts of one scene."""

    scene: Scene
    """The scene, with what is sketched in place of its colours."""

    @staticmethod
    def of(scene: Scene) -> "Sketcher":
        """The sketcher of a scene with levels."""
        variances = color_variances(scene)
        shown = np.zeros((len(scene), 1, 3), np.float32)
        shown[:, 0, 0], shown[:, 0, 1] = variances, ~scene.tree.is_leaf
        sh = np.where(shown > 0, (shown - np.float32(0.5)) / np.float32(SH_C0), BLACK)
        return Sketcher(replace(scene, gaussians=replace(scene.gaussians, sh=sh)))

    def draw(self, rows: Array, camera: Camera, *, threads: int = 0) -> Sketch:
        """The sketch of selected rows."""
        K = camera.K.copy()
        K[:2] /= SKETCH_PX
        width, height = (-(-size // SKETCH_PX) for size in (camera.width, camera.height))
        view = View(replace(camera, K=K, width=width, height=height), mode=self.scene.mode, sh_degree=0)
        scene = self.scene
        splats = stages.project(scene.gaussians, scene.ids, rows, view, curves=scene.tree.curves, threads=threads)
        picture = stages.blend(splats, stages.bin(splats, view, threads=threads), view, threads=threads)
        varied, merged, _ = picture.image.mean(axis=(0, 1), dtype=np.float64)
        return Sketch(float(merged), float(varied))


def color_variances(scene: Scene) -> Float32[Array, "n"]:
    """Variance of the colours of the leaves below each row, summed over red, green and blue; 0 for leaves."""
    gaussians, tree = scene.gaussians, scene.tree
    weights = _weights(gaussians, tree.is_leaf)
    totals = _sums_below(weights, tree.subtree_end)
    variances = np.zeros(len(tree))
    for channel in range(3):
        colors = np.maximum(gaussians.sh[:, 0, channel].astype(np.float64) * SH_C0 + 0.5, 0)
        means = _sums_below(weights * colors, tree.subtree_end) / totals
        variances += _sums_below(weights * colors**2, tree.subtree_end) / totals - means**2
    return np.where(tree.is_leaf, 0, np.maximum(variances, 0)).astype(np.float32)


def _weights(gaussians: Gaussians, is_leaf: Array) -> Float64[Array, "n"]:
    """Opacity times area of leaves; 0 for inner nodes, which stand for leaves that are counted themselves."""
    larger_two = gaussians.log_scales.sum(axis=1, dtype=np.float64) - gaussians.log_scales.min(axis=1)
    with np.errstate(over="ignore"):
        areas = np.exp(larger_two - np.median(larger_two)) * gaussians.opacities()
    return np.where(is_leaf, np.clip(areas, 1 / LARGEST_WEIGHT, LARGEST_WEIGHT), 0)


def _sums_below(values: Float64[Array, "n"], subtree_end: Array) -> Float64[Array, "n"]:
    """The sum over the rows of each subtree."""
    sums = np.cumsum(values)
    before = np.concatenate([[0.0], sums[:-1]])
    return np.asarray(sums[subtree_end - 1] - before)
