"""``splatree build`` through files: a folder of parts, for scenes larger than memory."""

from dataclasses import dataclass, replace

from splatree.cli.console import counted, size
from splatree.cli.files import Files, inputs_and_folder, read_options, told
from splatree.cli.radius_check import are_usual, warnings_of
from splatree.lod.options import BuildOptions
from splatree.outofcore.build import BuiltFolder
from splatree.outofcore.cut import opened_inputs
from splatree.outofcore.options import FolderOptions
from splatree.render.folder import build_folder
from splatree.render.trial import middle_of_chunks
from splatree.scene.names import Mode

__all__ = ["Memory", "in_words", "run_through_files"]


@dataclass(frozen=True)
class Memory:
    """How a verb goes through files; as `FolderOptions`, without what only levels need."""

    max_memory: str | None = None
    """Go through files: most memory for all processes of this machine together, 4G or 500M; None: half of what is free,
    if another option asks for files."""
    workers: int = 1
    """Go through files, in so many processes at the same time; 1: this process alone."""
    scheduler: str | None = None
    """Go through files, on the workers of a Dask cluster: the address of its scheduler, such as tcp://10.0.0.5:8786."""
    part_rows: int | None = None
    """Go through files: rows of a cell; None: a million, or as many as memory allows. The result does not depend on it."""

    def options(self) -> FolderOptions:
        """The options of the library."""
        return FolderOptions(**vars(self))


def run_through_files(files: Files, options: BuildOptions, running: FolderOptions, mode: Mode | None) -> BuiltFolder:
    """Build the levels of the inputs through files, and say where levels by a radius show them badly."""
    inputs, output = inputs_and_folder(files)
    reading = read_options(files.reading)
    built = build_folder(
        inputs,
        output,
        options,
        running,
        reading=reading,
        mode=mode,
        force=files.force,
    )
    if not are_usual(options):
        return built
    with opened_inputs(inputs, reading, mode) as opened:
        sample = middle_of_chunks(opened.chunks)
    return replace(built, notes=(*built.notes, *warnings_of(sample)))


def in_words(built: BuiltFolder) -> str:
    """What was written."""
    wrote = (
        f"wrote {built.path}: {counted(built.num_gaussians, 'Gaussian')}, {counted(built.num_nodes, 'node')} "
        f"({built.num_nodes / max(1, built.num_gaussians):.2f} ×), {counted(built.num_parts, 'part')}, {size(built.bytes)}"
    )
    by = "pairs" if built.rules["rule"] == "pairs" else "a radius"
    tried = [] if built.trial is None else [f"levels by {by}: {built.trial.in_words()}"]
    return "\n".join([wrote, *tried, *told(built.repairs, (), built.notes)])
