"""Build levels of detail through files, by the method that suits the scene: `build_lod` for scenes larger than memory."""

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

from splatree.io.options import ReadOptions
from splatree.lod.options import BuildOptions
from splatree.outofcore.build import BuiltFolder, check_target, grow_folder
from splatree.outofcore.cut import opened_inputs
from splatree.outofcore.options import FolderOptions
from splatree.render.trial import FEWEST, middle_of_chunks, try_both
from splatree.scene.arguments import checked
from splatree.scene.given import given
from splatree.scene.names import Mode

__all__ = ["build_folder"]


@checked
def build_folder(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: BuildOptions | None = None,
    running: FolderOptions | None = None,
    *,
    reading: ReadOptions | None = None,
    mode: Mode | None = None,
    executor: Executor | None = None,
    force: bool = False,
) -> BuiltFolder:
    """Build levels of detail over a scene that is larger than memory, and write a folder of parts.

    Levels by a radius are those of `build_lod`, bit for bit, but for the identities of merged nodes. Levels by pairs are chosen
    in cells of 2¹⁸ Gaussians (``running.part_rows``); what lies at their borders waits, and is merged at the size that it waited
    at with what waits across the border. They depend on the cells, but neither on memory nor on workers. The method `auto` is
    chosen as in `build_lod`, which reads the inputs twice more.

    A build that was interrupted goes on where it stopped if it is called again in the same way. Until it ends, its files are in a
    folder beside the output, with ``.work`` after its name.

    Args:
        inputs: one path or several of one scene, of formats that are read in chunks (`splatree formats`); of scenes with levels
            the leaves are taken.
        output: the new folder.
        options: how levels grow. None: the defaults.
        running: memory, processes and the size of parts; None: half of the free memory and this process.
        reading: how the inputs are read.
        mode: how the scene is drawn, where the files do not say it.
        executor: runs the cells, in any process that sees the files of the output and the folder beside it, and that runs this
            version on a processor of the same kind; None: ``running.workers`` processes of this machine.
        force: replace the folder if it exists.

    Returns:
        What was written.

    Raises:
        FormatError: an input does not hold what it promises.
        InputError: an input is not read in chunks, an option does not suit, a cell needs more memory than there is, or a cluster
            cannot take part.
        MissingExtraError: a scheduler is named, and Dask is not installed.
        OutputError: the output exists, could not be written, or is written by another process.

    Source:
        docs/explanation/out-of-core.md.

    Example:
        >>> built = st.build_folder("city.ply", "city_parts.splatree")
        >>> len(st.read("city_parts.splatree")) == built.num_nodes
        True
    """
    options, reading = (
        given(options, BuildOptions, "build_folder: options"),
        given(reading, ReadOptions, "build_folder: reading"),
    )
    running = given(running, FolderOptions, "build_folder: running")
    check_target(output, force=force)
    trial = None
    if options.only_method is None:
        with opened_inputs(inputs, reading, mode) as opened:
            if len(opened.chunks) >= FEWEST:
                trial = try_both(middle_of_chunks(opened.chunks), options).trial
        options = replace(options, method="radius" if trial is None else trial.better)
    return grow_folder(
        *(inputs, output, options, running),
        reading=reading,
        mode=mode,
        executor=executor,
        force=force,
        trial=trial,
    )
