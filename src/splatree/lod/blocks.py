"""The block index of a scene: made once, so that each selection looks only at blocks that can be seen."""

from dataclasses import replace

from splatree.constants import BLOCK_ROWS
from splatree.errors import InputError
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.scene.scene import Scene

__all__ = ["with_blocks"]


def with_blocks(scene: Scene, *, rows_per_block: int = BLOCK_ROWS, threads: int = 0) -> Scene:
    """The scene with its block index; as it is if it has one already with blocks of that size.

    Call it again after replacing ``gaussians`` or ``tree``, with ``blocks=None`` in the replacement.
    """
    if not 16 <= rows_per_block <= 1024:
        raise InputError(f"rows_per_block: found {rows_per_block}, wanted 16 to 1024")
    if scene.blocks is not None and scene.blocks.rows_per_block == rows_per_block:
        return scene
    blocks = index_blocks(scene.gaussians, scene.tree, rows_per_block=rows_per_block, threads=threads)
    return replace(scene, blocks=blocks)
