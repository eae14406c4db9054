"""A ``.rad`` as a stream: one file, of which Spark loads the chunks that it needs by ranges of bytes."""

from dataclasses import replace
from pathlib import Path

from splatree.errors import InputError
from splatree.io.formats.rad.container import open_rad
from splatree.io.writing import write
from splatree.kernels.reference.paging import PAGE_ROWS
from splatree.scene.scene import Scene
from splatree.stream.nodes import gaussians_of_tree
from splatree.stream.options import StreamOptions
from splatree.stream.result import LevelWritten, Streamed

__all__ = ["as_written", "write_rad"]

_NODE_PX = 4.0
"""Extent at which Spark draws nodes of a cut of half as many nodes as leaves (nodes.py)."""


def as_written(scene: Scene, options: StreamOptions) -> Scene:
    """The scene with its nodes as Spark draws them within a budget."""
    node_px = _NODE_PX if options.node_px is None else options.node_px
    tree = replace(scene.tree, curves=None)
    return replace(scene, gaussians=gaussians_of_tree(scene, node_px), tree=tree, clusters=None, blocks=None)


def write_rad(scene: Scene, output: Path, options: StreamOptions, *, force: bool = False) -> Streamed:
    """Write a scene with levels.

    Raises:
        InputError: the name does not end in ``.rad``.
        OutputError: there is a file already, or the disk fails.
    """
    if output.suffix != ".rad":
        raise InputError(f"{output}: found the name of a stream for Spark, wanted one that ends in .rad")
    write(as_written(scene, options), output, force=force)
    num_bytes = output.stat().st_size
    everything = LevelWritten(0, len(scene), 0.0, 1, num_bytes)
    return Streamed(output, "rad", -(-open_rad(output).count // PAGE_ROWS), (everything,), 1, 0, num_bytes)
