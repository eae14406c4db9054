"""Index the blocks of a tree: glue over blocks.cpp; kernels/reference/blocks.py is the definition."""

import numpy as np

from splatree.constants import BLOCK_ROWS, BLOCK_STEPS, BLOCKS_PER_GROUP
from splatree.kernels.cpu import _core
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.shapes import Array

__all__ = ["index_blocks"]


def index_blocks(
    gaussians: Gaussians, tree: GaussianTree, *, rows_per_block: int = BLOCK_ROWS, threads: int = 0
) -> BlockIndex:
    """Bounds and ancestors of all blocks; one pass over the rows."""
    num_blocks = -(-len(tree) // rows_per_block)
    num_groups = -(-num_blocks // BLOCKS_PER_GROUP)
    start, ancestors = _core.block_ancestors(tree.subtree_end, rows_per_block)
    # The kernel fills the arrays of the struct, before anyone else has it.
    blocks = BlockIndex(
        rows_per_block,
        lower=_floats(num_blocks, 3),
        upper=_floats(num_blocks, 3),
        leaf_scales=_floats(num_blocks),
        step_extents=_floats(num_blocks, BLOCK_STEPS),
        step_scales=_floats(num_blocks, BLOCK_STEPS),
        min_logits=_floats(num_blocks),
        ancestor_start=start,
        ancestors=ancestors,
        group_lower=_floats(num_groups, 3),
        group_upper=_floats(num_groups, 3),
        group_leaf_scales=_floats(num_groups),
        size_classes=np.empty(len(tree), np.uint8),
    )
    _core.block_bounds(gaussians, tree, blocks, threads)
    return blocks


def _floats(*shape: int) -> Array:
    """Space that the kernel fills."""
    return np.empty(shape, np.float32)
