"""Merging on the processor: the groups of ``reference/merge.py``, in float64, rounded once to float32."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.scene.thinning import Groups, MergeOptions
from splatree.shapes import Array, Float32, Int32

__all__ = ["average_children", "merge"]


def merge(
    gaussians: Gaussians,
    groups: Groups,
    weights: Float32[Array, "n"],
    options: MergeOptions,
    *,
    added: float = 0.0,
    opacities: Float32[Array, "g"] | None = None,
    threads: int = 0,
) -> Gaussians:
    """One Gaussian for each group, in the order of the groups; ``options`` resolved. `fitted` is `standard` here:
    the caller has the opacities.

    ``added`` is added to variances where areas are compared, world units², besides the options' dilation.
    Where ``opacities`` is above 0, it is what a group of two or more gets in place of the rule's.
    """
    assert options.opacity is not None
    g, k = len(groups), gaussians.sh.shape[1]
    shapes = ((g, 3), (g, 4), (g, 3), (g,), (g, k, 3))
    out = Gaussians(*(np.empty(shape, np.float32) for shape in shapes))
    _core.merge(gaussians, groups, weights, options, added, opacities, out, threads)
    return out


def average_children(
    values: Float32[Array, "n k 3"],
    subtree_end: Int32[Array, "n"],
    weights: Float32[Array, "n"],
    *,
    threads: int = 0,
) -> None:
    """Overwrite the values of each inner node of a tree in preorder with the weighted mean of its children's."""
    _core.average_children(subtree_end, weights, values, int(np.prod(values.shape[1:])), threads)
