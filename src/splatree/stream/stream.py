"""A scene as what viewers on the web load piece by piece."""

import os
from dataclasses import replace
from pathlib import Path
from typing import get_args

from splatree.errors import InputError
from splatree.io.formats.streamed_sog.format import MANIFEST as SOG_MANIFEST
from splatree.io.registry import formats
from splatree.io.replacing import check_free
from splatree.lod.options import BuildOptions
from splatree.render.build import build_lod
from splatree.scene.given import check_threads, given
from splatree.scene.scene import Scene, check_is_scene
from splatree.stream.archive import write_archive
from splatree.stream.options import StreamFormat, StreamOptions
from splatree.stream.parts import check_folder
from splatree.stream.rad import write_rad
from splatree.stream.result import Streamed
from splatree.stream.sog import write_sog
from splatree.stream.tiles import MANIFEST as TILES_MANIFEST
from splatree.stream.tiles import write_tiles

__all__ = ["stream"]


def stream(
    scene: Scene,
    output: str | os.PathLike[str],
    format: StreamFormat = "sog",
    options: StreamOptions | None = None,
    *,
    force: bool = False,
    threads: int = 0,
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

    Returns:
        What was written.

    Raises:
        InputError: the scene is empty, or the options contradict the format or each other.
        OutputError: there is something else at ``output``, or a stream without ``force``, or the disk fails.

    Source:
        PlayCanvas, "Streamed SOG" (lod-meta.json, version 1); sparkjsdev/spark, rad.rs and chunk_tree.rs; OGC 22-025r4, 3D Tiles
        1.1.

    Example:
        >>> written = st.stream(scene, "city_stream")
        >>> len(st.read("city_stream", level=0)) == scene.tree.num_leaves
        True
    """
    check_is_scene(scene, "stream")
    options = given(options, StreamOptions, "stream: options")
    check_threads(threads)
    if len(scene) == 0:
        raise InputError("stream: found an empty scene, wanted at least one Gaussian")
    if format not in get_args(StreamFormat):
        raise InputError(f"format: found {format!r}, wanted one of {', '.join(get_args(StreamFormat))}")
    options.check_used(format)
    check_output(Path(output), format, options, force=force)
    degree = scene.gaussians.sh_degree if options.sh_degree is None else options.sh_degree
    if degree < scene.gaussians.sh_degree:
        scene = replace(scene, gaussians=scene.gaussians.with_sh_degree(degree), clusters=None)
    scene = with_levels(scene, threads=threads)
    return replace(_written(scene, Path(output), format, options, force=force, threads=threads), options=options)


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


def _written(
    scene: Scene, output: Path, format: StreamFormat, options: StreamOptions, *, force: bool, threads: int
) -> Streamed:
    if format == "rad":
        return write_rad(scene, output, options, force=force)
    if format == "3dtiles":
        return write_tiles(scene, output, options, force=force, threads=threads)
    if options.zip:
        return write_archive(scene, output, options, force=force, threads=threads)
    return write_sog(scene, output, options, force=force, threads=threads)


_FILES = (*(suffix for f in formats() for suffix in f.suffixes), ".json", ".zip")
"""Endings of names that no folder should have."""


def with_levels(scene: Scene, *, threads: int = 0) -> Scene:
    """The scene, with levels by pairs if it has none."""
    if scene.tree.num_leaves < len(scene):
        return scene
    return build_lod(scene, BuildOptions(method="pairs"), threads=threads)
