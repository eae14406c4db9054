"""A streamed SOG as one file: a ZIP of its folder, `.ssog`, which LichtFeld Studio opens.

Units are compressed already, so the ZIP stores them as they are. Its entries are in the order of the manifest, which comes first,
and have no date: the same stream gives the same bytes.
"""

import json
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

from splatree.errors import SplatreeError
from splatree.io.formats.streamed_sog.format import MANIFEST
from splatree.io.memory import Scratch
from splatree.io.replacing import name_in, replacing
from splatree.scene.scene import Scene
from splatree.stream.options import StreamOptions
from splatree.stream.result import Streamed
from splatree.stream.sog import write_sog

__all__ = ["write_archive"]


def write_archive(
    scene: Scene,
    output: Path,
    options: StreamOptions,
    scratch: Scratch,
    *,
    force: bool = False,
    threads: int = 0,
) -> Streamed:
    """Write a scene with levels as a streamed SOG in a ZIP.

    Raises:
        InputError: the options cannot be met.
        OutputError: there is a file already, or the disk fails.
    """
    with (
        replacing(output, force=force) as temporary,
        tempfile.TemporaryDirectory(dir=output.parent, prefix=".") as made,
    ):
        folder = Path(made) / output.stem
        try:
            written = write_sog(scene, folder, options, scratch, threads=threads)
        except SplatreeError as error:
            error.args = tuple(name_in(str(part), folder, output) for part in error.args)
            raise
        _zip(folder, temporary)
    return replace(written, output=output, bytes=output.stat().st_size)


def _zip(folder: Path, target: Path) -> None:
    units = [Path(name).parent for name in json.loads((folder / MANIFEST).read_text("utf-8"))["filenames"]]
    names = [Path(MANIFEST), *(unit / file.name for unit in units for file in sorted((folder / unit).iterdir()))]
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as bundle:
        for name in names:
            bundle.writestr(zipfile.ZipInfo(name.as_posix()), (folder / name).read_bytes())
