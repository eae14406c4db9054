"""A scene as what viewers on the web load piece by piece."""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from splatree.errors import InputError
from splatree.io.chunks import ROWS_PER_CHUNK
from splatree.io.formats.streamed_sog.format import MANIFEST as SOG_MANIFEST
from splatree.io.memory import SMALLEST_MEMORY, Scratch, bytes_of
from splatree.io.registry import formats
from splatree.io.replacing import check_free
from splatree.lod.options import BuildOptions
from splatree.render.build import build_lod
from splatree.scene.arguments import checked
from splatree.scene.given import check_threads, given
from splatree.scene.scene import Scene
from splatree.stream.archive import write_archive
from splatree.stream.options import StreamFormat, StreamOptions
from splatree.stream.parts import check_folder
from splatree.stream.rad import write_rad
from splatree.stream.result import Streamed
from splatree.stream.sog import write_sog
from splatree.stream.tiles import MANIFEST as TILES_MANIFEST
from splatree.stream.tiles import write_tiles

__all__ = ["stream"]


@checked
def stream(
    scene: Scene,
    output: str | os.PathLike[str],
    format: StreamFormat = "sog",
    options: StreamOptions | None = None,
    *,
    force: bool = False,
    threads: int = 0,
    max_memory: str | None = None,
) -> Streamed:
    """Write a scene as a stream that viewers on the web load piece by piece, finer where the camera is near.

    All formats are cut from the scene's one tree. A scene without levels gets them first, by pairs. A stream that was interrupted
    goes on where it stopped when the same call is made again.

    Args:
        scene: the scene, with levels or without.
        output: the folder (`sog`, `3dtiles`) or the file (`rad`, a zipped `sog`) to write.
        format: who reads it: `sog` for PlayCanvas, SuperSplat and Babylon.js, `rad` for Spark, `3dtiles` for CesiumJS.
        options: how the stream is cut; None: the defaults.
        force: replace an older stream.
        threads: threads to use; 0: all. The files are the same for any number.
        max_memory: memory that may be taken beside the scene, such as 4G; what needs more waits in files beside the output, and
            fewer threads are used. The files are the same. None: half of what is free.

    Returns:
        What was written.

    Raises:
        InputError: the scene is empty, the options contradict the format or each other, or ``max_memory`` is less than 250M.
        OutputError: there is something else at ``output``, or a stream without ``force``, or the disk fails.

    Source:
        PlayCanvas, "Streamed SOG" (lod-meta.json, version 1); sparkjsdev/spark, rad.rs and chunk_tree.rs; OGC 22-025r4, 3D Tiles
        1.1.

    Example:
        >>> written = st.stream(scene, "city_stream")
        >>> len(st.read("city_stream", level=0)) == scene.tree.num_leaves
        True
    """
    options = given(options, StreamOptions, "stream: options")
    check_threads(threads)
    if len(scene) == 0:
        raise InputError("stream: found an empty scene, wanted at least one Gaussian")
    if format not in get_args(StreamFormat):
        raise InputError(f"format: found {format!r}, wanted one of {', '.join(get_args(StreamFormat))}")
    options.check_used(format)
    check_output(Path(output), format, options, force=force)
    scratch = scratch_beside(Path(output), max_memory)
    scene = with_levels(of_degree(scene, options.sh_degree, scratch), threads=threads)
    write = _writer(format, options, threads)
    return replace(write(scene, Path(output), options, scratch, force=force), options=options)


def check_output(output: Path, format: StreamFormat, options: StreamOptions, *, force: bool) -> None:
    """Refuse an output that cannot be written, before any work is done for it.

    Raises:
        InputError: its name is that of a file and the stream is a folder, or the other way round.
        OutputError: there is something else, or a stream already and ``force`` is not set.
    """
    is_folder = format == "3dtiles" or (format == "sog" and not options.zip)
    if not is_folder:
        suffix, who = (".rad", "Spark") if format == "rad" else (".ssog", "LichtFeld Studio, a ZIP")
        if output.suffix != suffix:
            raise InputError(f"{output}: found the name of a stream for {who}, wanted one that ends in {suffix}")
        check_free(output, force=force)
        return
    if output.suffix == ".rad":
        raise InputError(
            f"{output}: found the name of a stream for Spark and the format {format}; choose the format rad (--format rad)"
        )
    if output.suffix == ".ssog":
        raise InputError(
            f"{output}: found the name of a zipped stream; choose the format sog with the option zip (--format sog --zip)"
        )
    if output.name in (SOG_MANIFEST, TILES_MANIFEST):
        raise InputError(
            f"{output}: found the name of a manifest, wanted that of the folder around it: {output.parent}"
        )
    if output.name.lower().endswith(_FILES):
        raise InputError(
            f"{output}: found the name of a file, but a stream of the format {format} is a folder of many files; wanted a name "
            f"such as {output.with_suffix('')}"
        )
    check_folder(output, SOG_MANIFEST if format == "sog" else TILES_MANIFEST, force=force)


def _writer(format: StreamFormat, options: StreamOptions, threads: int) -> Callable[..., Streamed]:
    if format == "rad":
        return write_rad
    if format == "3dtiles":
        return partial(write_tiles, threads=threads)
    return partial(write_archive if options.zip else write_sog, threads=threads)


def scratch_beside(output: Path, max_memory: str | None) -> Scratch:
    """Room for what grows with the scene.

    Raises:
        InputError: the memory is no number of bytes, or too little for anything.
    """
    if max_memory is not None and bytes_of(max_memory) < SMALLEST_MEMORY:
        raise InputError(f"max_memory: found {max_memory}, wanted at least {SMALLEST_MEMORY // 10**6}M")
    return Scratch.beside(output, max_memory)


def of_degree(scene: Scene, sh_degree: int | None, scratch: Scratch) -> Scene:
    """The scene without harmonics above a degree; None: with all of them."""
    g = scene.gaussians
    if sh_degree is None or sh_degree >= g.sh_degree:
        return scene
    sh = scratch.zeros((len(g), (sh_degree + 1) ** 2, 3), np.float32)
    for begin in range(0, len(g), ROWS_PER_CHUNK):
        sh[begin : begin + ROWS_PER_CHUNK] = g.sh[begin : begin + ROWS_PER_CHUNK, : sh.shape[1]]
    return replace(scene, gaussians=replace(g, sh=sh), clusters=None)


_FILES = (*(suffix for f in formats() for suffix in f.suffixes), ".json", ".zip")
"""Endings of names that no folder should have."""


def with_levels(scene: Scene, *, threads: int = 0) -> Scene:
    """The scene, with levels by pairs if it has none."""
    if scene.tree.num_leaves < len(scene):
        return scene
    return build_lod(scene, BuildOptions(method="pairs"), threads=threads)
