"""``splatree build`` through files: a folder of parts, for scenes larger than memory."""

from splatree.cli.console import UsageError, counted, size
from splatree.cli.files import Files, inputs_and_folder, told
from splatree.io.options import ReadOptions
from splatree.lod.options import BuildOptions
from splatree.outofcore.build import BuiltFolder, build_folder
from splatree.outofcore.options import FolderOptions
from splatree.scene.names import Mode

__all__ = ["in_words", "run_through_files"]


def run_through_files(files: Files, options: BuildOptions, running: FolderOptions, mode: Mode | None) -> BuiltFolder:
    """Build the levels of the inputs through files."""
    if options.only_method == "pairs":
        raise UsageError(
            "found --method pairs, or options of pairs, with --max-memory, --workers or the size of parts; wanted --method "
            "radius: pairs are chosen from the whole scene in memory"
        )
    inputs, output = inputs_and_folder(files)
    reading = files.reading
    return build_folder(
        inputs,
        output,
        options,
        running,
        reading=ReadOptions(
            repair=reading.repair, axes=reading.input_axes, ignore_properties=reading.ignore_properties
        ),
        mode=mode,
        force=files.force,
    )


def in_words(built: BuiltFolder) -> str:
    """What was written."""
    wrote = (
        f"wrote {built.path}: {counted(built.num_gaussians, 'Gaussian')}, {counted(built.num_nodes, 'node')} "
        f"({built.num_nodes / max(1, built.num_gaussians):.2f} ×), {counted(built.num_parts, 'part')}, {size(built.bytes)}"
    )
    return "\n".join([wrote, *told(built.repairs, (), built.notes)])
