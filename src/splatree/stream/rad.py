"""A ``.rad`` as a stream: one file, of which Spark loads the chunks that it needs by ranges of bytes."""

from pathlib import Path

from splatree.errors import InputError
from splatree.io.formats.rad.container import open_rad
from splatree.io.writing import write
from splatree.kernels.reference.paging import PAGE_ROWS
from splatree.scene.scene import Scene
from splatree.stream.result import LevelWritten, Streamed

__all__ = ["write_rad"]


def write_rad(scene: Scene, output: Path, *, force: bool = False) -> Streamed:
    """Write a scene with levels.

    Raises:
        InputError: the name does not end in ``.rad``.
        OutputError: there is a file already, or the disk fails.
    """
    if output.suffix != ".rad":
        raise InputError(f"{output}: found the name of a stream for Spark, wanted one that ends in .rad")
    write(scene, output, force=force)
    num_bytes = output.stat().st_size
    everything = LevelWritten(0, len(scene), 0.0, 1, num_bytes)
    return Streamed(output, "rad", -(-open_rad(output).count // PAGE_ROWS), (everything,), 1, 0, num_bytes)
