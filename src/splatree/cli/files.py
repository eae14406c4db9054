"""Inputs and outputs of a verb: ``verb in.ply out.ply``, or ``verb chunk_*/ -o out.ply`` for several inputs."""

from collections.abc import Sequence
from pathlib import Path

from splatree.errors import InputError


def inputs_and_output(paths: Sequence[Path], output: Path | None) -> tuple[tuple[Path, ...], Path]:
    """The inputs, and the output: named with ``-o``, or else the last path.

    Raises:
        InputError: there is no input, or no output, or an output that is also read.
    """
    inputs = tuple(paths)
    if output is None:
        if len(inputs) < 2:
            found = "one path" if inputs else "no path"
            raise InputError(f"found {found}, wanted an input and an output: in.ply out.ply, or chunk_*/ -o out.ply")
        *sources, output = inputs
        inputs = tuple(sources)
        if output.is_dir():
            # `build chunk_*/` without -o: the last chunk is an input, surely.
            raise InputError(f"{output}: is a folder, wanted a file to write; name the output with -o")
    if not inputs:
        raise InputError("found no input, wanted at least one: in.ply out.ply, or chunk_*/ -o out.ply")
    if any(path.exists() and output.exists() and path.samefile(output) for path in inputs):
        raise InputError(f"{output}: is an input too; choose another name for the output")
    return inputs, output
