"""Index the blocks of a tree: glue over blocks.cpp; kernels/reference/blocks.py is the definition."""

import numpy as np

from splatree.constants import BLOCK_ROWS, BLOCKS_PER_GROUP
from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import BlockIndex, GaussianTree

__all__ = ["index_blocks"]


def index_blocks(
    gaussians: Gaussians, tree: GaussianTree, *, rows_per_block: int = BLOCK_ROWS, threads: int = 0
) -> BlockIndex:
    """Bounds and ancestors of all blocks; one pass over the rows."""
    num_blocks = -(-len(tree) // rows_per_block)
    num_groups = -(-num_blocks // BLOCKS_PER_GROUP)
    lower, upper = (np.empty((num_blocks, 3), np.float32) for _ in range(2))
    leaf_scales, min_logits = (np.empty(num_blocks, np.float32) for _ in range(2))
    group_lower, group_upper = (np.empty((num_groups, 3), np.float32) for _ in range(2))
    group_leaf_scales = np.empty(num_groups, np.float32)
    size_classes = np.empty(len(tree), np.uint8)
    of_blocks = (lower, upper, leaf_scales, min_logits)
    of_groups = (group_lower, group_upper, group_leaf_scales)
    _core.block_bounds(gaussians, tree, rows_per_block, *of_blocks, *of_groups, size_classes, threads)
    start, ancestors = _core.block_ancestors(tree.subtree_end, rows_per_block)
    return BlockIndex(rows_per_block, *of_blocks, start, ancestors, *of_groups, size_classes)
