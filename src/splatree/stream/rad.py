"""A ``.rad`` as a stream: one file, of which Spark loads the chunks that it needs by ranges of bytes; or a file a chunk."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path

from splatree.io.formats.rad.container import open_rad
from splatree.io.formats.rad.writer import write_chunked
from splatree.io.memory import Scratch
from splatree.io.replacing import replacing
from splatree.io.writing import write
from splatree.kernels.reference.paging import PAGE_ROWS
from splatree.scene.scene import Scene
from splatree.stream.families import without_equals
from splatree.stream.nodes import gaussians_of_tree
from splatree.stream.options import StreamOptions
from splatree.stream.result import LevelWritten, Streamed

__all__ = ["as_written", "write_rad"]

_NODE_PX = 4.0
"""Extent at which Spark draws nodes of a cut of half as many nodes as leaves (nodes.py)."""


def as_written(scene: Scene, options: StreamOptions, scratch: Scratch | None = None) -> Scene:
    """The scene with its nodes as Spark draws them within a budget, without those that it hardly ever draws.

    What grows with the scene lies in ``scratch``.
    """
    scratch = scratch or Scratch.endless()
    node_px = _NODE_PX if options.node_px is None else options.node_px
    tree = replace(scene.tree, curves=None)
    drawn = replace(scene, gaussians=gaussians_of_tree(scene, node_px, scratch), tree=tree, clusters=None, blocks=None)
    return without_equals(drawn, scratch)


def write_rad(scene: Scene, output: Path, options: StreamOptions, scratch: Scratch, *, force: bool = False) -> Streamed:
    """Write a scene with levels.

    Raises:
        OutputError: there is a file already, or the disk fails.
    """
    names = []
    scene = as_written(scene, options, scratch)
    if options.chunked:
        names = _write_chunked(scene, output, force=force)
    else:
        write(scene, output, force=force)
    num_bytes = sum(path.stat().st_size for path in (output, *(output.parent / name for name in names)))
    everything = LevelWritten(0, len(scene), 0.0, max(1, len(names)), num_bytes)
    num_chunks = -(-open_rad(output).count // PAGE_ROWS)
    return Streamed(output, "rad", num_chunks, (everything,), 1 + len(names), 0, 0, num_bytes)


def _write_chunked(scene: Scene, output: Path, *, force: bool) -> list[str]:
    """Each chunk as a file beside the header, which is written last; then remove the chunks of an older stream.

    The names of chunks end in a digest of their contents. So an old stream stays whole until the new header is there.
    """
    names = []

    def write_chunk(number: int, chunk: bytes) -> str:
        name = f"{output.stem}-{number}-{hashlib.blake2b(chunk, digest_size=6).hexdigest()}.radc"
        names.append(name)
        with replacing(output.parent / name, force=True) as temporary:
            temporary.write_bytes(chunk)
        return name

    with replacing(output, force=force) as temporary:
        write_chunked(scene, temporary, write_chunk)
    older = re.compile(rf"{re.escape(output.stem)}-\d+-[0-9a-f]{{12}}\.radc")
    for path in output.parent.iterdir():
        if older.fullmatch(path.name) and path.name not in names:
            path.unlink()
    return names
