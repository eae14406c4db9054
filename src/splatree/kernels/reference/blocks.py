"""Blocks of consecutive rows and what the selection asks of a whole block, by definition (scene/tree.py: `BlockIndex`)."""

import numpy as np

from splatree.constants import BLOCK_ROWS, BLOCK_STEPS, BLOCKS_PER_GROUP, SIGMAS
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import BlockIndex, GaussianTree

__all__ = ["index_blocks"]


def index_blocks(
    gaussians: Gaussians, tree: GaussianTree, *, rows_per_block: int = BLOCK_ROWS, threads: int = 0
) -> BlockIndex:
    """Bounds and ancestors of all blocks; ``threads`` is not used."""
    n = len(tree)
    starts = range(0, n, rows_per_block)
    log_scales = np.sort(gaussians.log_scales.astype(np.float64), axis=1)
    with np.errstate(divide="ignore"):
        log_thirds = np.log(tree.extents.astype(np.float64) / SIGMAS)
    # Beyond the extent by more than the rounding of one that is 3σ.
    counts = tree.is_leaf | (log_scales[:, 2] > log_thirds + 1e-5)
    largest = np.where(counts, np.exp(log_scales[:, 2]), 0.0)
    size_classes = np.clip(np.floor(np.minimum(log_scales[:, 1], log_thirds) * (8 / np.log(2))) + 128, 0, 254)
    size_classes[np.isnan(gaussians.means).any(axis=1)] = (
        254  # boxes pass over these rows, so bounds say nothing of them
    )
    lists = [np.flatnonzero(tree.subtree_end[:first] > first) for first in starts]

    def bound(values: np.ndarray, reduce: np.ufunc, rows: int) -> np.ndarray:
        runs = [reduce.reduce(values[first : first + rows], axis=0) for first in range(0, n, rows)]
        return np.array(runs, np.float32).reshape(-1, *values.shape[1:])

    runs = [np.arange(first, min(first + rows_per_block, n)) for first in starts]
    steps = [_steps(largest[rows], np.where(tree.is_leaf, 0.0, tree.extents)[rows]) for rows in runs]
    rows_per_group = rows_per_block * BLOCKS_PER_GROUP
    return BlockIndex(
        rows_per_block,
        lower=bound(gaussians.means, np.minimum, rows_per_block),
        upper=bound(gaussians.means, np.maximum, rows_per_block),
        leaf_scales=bound(largest, np.maximum, rows_per_block),
        step_extents=np.array([extents for extents, _ in steps], np.float32).reshape(-1, BLOCK_STEPS),
        step_scales=np.array([scales for _, scales in steps], np.float32).reshape(-1, BLOCK_STEPS),
        min_logits=bound(gaussians.logit_opacities, np.minimum, rows_per_block),
        ancestor_start=np.cumsum([0, *map(len, lists)]).astype(np.int32),
        ancestors=np.concatenate([np.zeros(0, np.int64), *lists]).astype(np.int32),
        group_lower=bound(gaussians.means, np.minimum, rows_per_group),
        group_upper=bound(gaussians.means, np.maximum, rows_per_group),
        group_leaf_scales=bound(largest, np.maximum, rows_per_group),
        size_classes=np.where(tree.is_leaf, 255, size_classes).astype(np.uint8),
    )


def _steps(scales: np.ndarray, extents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The extents from which on rows are larger than all those of less extent, and how large; 0 is the first.

    Of too many steps the first ones behind 0 become one.
    """
    found = [(0.0, scales[extents == 0].max(initial=0.0))]
    for extent in np.unique(extents[extents > 0]):
        scale = scales[extents <= extent].max()
        if scale > found[-1][1]:
            found.append((extent, scale))
    surplus = len(found) - BLOCK_STEPS
    if surplus > 0:
        found[1 : surplus + 2] = [(found[1][0], found[surplus + 1][1])]
    found += [(np.inf, found[-1][1])] * -min(surplus, 0)
    return np.array([extent for extent, _ in found]), np.array([scale for _, scale in found])
