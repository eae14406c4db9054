"""The formats, one line each, and how the format of a path is found (reading.py and writing.py use it).

A format is recognised by its content first (`sniff`) and by its suffix second. A new one is a module with ``sniff``, ``read``
and, if it is written, ``write`` or ``write_chunks``, and an entry in `FORMATS`; order matters only where two would claim the
same file. What a format cannot hold follows from its `Holds`; a writer returns what else it had to change, in plain words.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatree.errors import FormatError, InputError, SplatreeError
from splatree.io.chunks import Chunks
from splatree.io.foreign import not_content, packed
from splatree.io.holds import Holds
from splatree.io.local import is_fetched_whole
from splatree.io.objects import located
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.runs import TreeRuns
from splatree.scene.scene import Scene

if TYPE_CHECKING:
    from splatree.io.formats.compressed_ply import format as compressed_ply
    from splatree.io.formats.folder import format as folder
    from splatree.io.formats.glb import reader as gltf
    from splatree.io.formats.glb import writer as glb_writer
    from splatree.io.formats.hier import format as hier
    from splatree.io.formats.ksplat import format as ksplat
    from splatree.io.formats.ksplat import writer as ksplat_writer
    from splatree.io.formats.ply import format as ply
    from splatree.io.formats.rad import reader as rad
    from splatree.io.formats.rad import writer as rad_writer
    from splatree.io.formats.sog import reader as sog
    from splatree.io.formats.sog import writer as sog_writer
    from splatree.io.formats.splat import format as splat
    from splatree.io.formats.splatree import format as store
    from splatree.io.formats.spz import format as spz
    from splatree.io.formats.streamed_sog import format as streamed_sog
    from splatree.io.formats.tiles3d import format as tiles3d
else:

    class _Later:
        """The module of a format, loaded when one of its functions is first called: most commands need two of them."""

        def __init__(self, module: str) -> None:
            self._module = f"splatree.io.{module}"

        def __getattr__(self, name: str) -> Callable[..., Any]:
            return lambda *arguments: getattr(import_module(self._module), name)(*arguments)

    compressed_ply = _Later("formats.compressed_ply.format")
    folder = _Later("formats.folder.format")
    glb_writer = _Later("formats.glb.writer")
    gltf = _Later("formats.glb.reader")
    hier = _Later("formats.hier.format")
    ksplat = _Later("formats.ksplat.format")
    ksplat_writer = _Later("formats.ksplat.writer")
    ply = _Later("formats.ply.format")
    rad = _Later("formats.rad.reader")
    rad_writer = _Later("formats.rad.writer")
    sog = _Later("formats.sog.reader")
    sog_writer = _Later("formats.sog.writer")
    splat = _Later("formats.splat.format")
    spz = _Later("formats.spz.format")
    store = _Later("formats.splatree.format")
    streamed_sog = _Later("formats.streamed_sog.format")
    tiles3d = _Later("formats.tiles3d.format")

FOLDER_FILE = "meta.json"
"""Name of a new file that asks for a folder of files."""

_HEAD_BYTES = 4096
"""How much of a file `sniff` is given."""


@dataclass(frozen=True)
class Format:
    """A kind of file or folder that holds a scene."""

    name: str
    """Short name, as in `Source.format`."""
    description: str
    """One line for tables."""
    suffixes: tuple[str, ...]
    """Endings of file names, lower case; empty if it is a folder."""
    versions: str
    """Versions that are read; in brackets those that are written, if they are fewer."""
    holds: Holds
    """What a file of it can say."""
    sniff: Callable[[Path, bytes], bool]
    """Whether a path holds this format, given the first bytes of a file (none for a folder)."""
    read: Callable[[Path, ReadOptions], Scene]
    """Read a path into a scene whose values were checked (`splatree.io.check.checked`)."""
    write: Callable[[Scene, Path, WriteOptions], tuple[str, ...]] | None = None
    """Write a file; return what was lost for other reasons than `holds`, a sentence each. None: ``write_chunks`` writes all."""
    write_folder: Callable[[Chunks, Path, WriteOptions], tuple[str, ...]] | None = None
    """As ``write_chunks``, but write a folder, given the path of its meta.json; None: there is no such form."""
    write_chunks: Callable[[Chunks, Path, WriteOptions], tuple[str, ...]] | None = None
    """As ``write``, of chunks of a scene without levels; takes its place if there is none. None too: the format is only read."""
    read_chunks: Callable[[Path, ReadOptions], Chunks | None] | None = None
    """Open a file to be read in chunks, with the values that ``read`` gives; it returns None for a file that cannot be."""
    read_leaves: Callable[[Path, ReadOptions], Chunks | None] | None = None
    """As ``read_chunks``, of the leaves of a scene with levels, in the order that they have in the whole scene."""
    read_runs: Callable[[Path], TreeRuns | None] | None = None
    """Open a file to be read in runs of rows, with its levels; it returns None for a file that cannot be."""
    whole_bytes: Callable[[Path], int] | None = None
    """Memory that ``read`` takes beside the program, by the head of a file; None: rows are read in chunks, or no head tells."""
    files: Callable[[Path], list[Path]] | None = None
    """The files that a path stands for, where they may be several; None: the file itself."""
    is_zip: bool = False
    """Whether a file of it is a ZIP."""
    may_be_empty: bool = False
    """Whether a file of no bytes is a scene without Gaussians."""
    options: tuple[str, ...] = ()
    """Fields of `WriteOptions` that the writer takes."""

    @property
    def is_written(self) -> bool:
        """Whether scenes can be written in it."""
        return self.write is not None or self.write_chunks is not None


FORMATS: tuple[Format, ...] = (
    Format(
        name="splatree",
        description="native, with levels",
        suffixes=(".splatree",),
        versions="1; 2 if compact",
        holds=Holds(origin=True, lossless=True, levels="tree", threshold=True, record=True, curves=True, clusters=True),
        sniff=store.sniff,
        read=store.read,
        read_leaves=store.read_leaves,
        read_runs=store.read_runs,
        write=store.write,
        write_chunks=store.write_chunks,
        options=("compact",),
    ),
    Format(
        name="splatree-folder",
        description="native, a folder of parts",
        suffixes=(),
        versions="1",
        holds=Holds(origin=True, lossless=True, levels="tree", threshold=True, record=True),
        sniff=folder.sniff,
        read=folder.read,
        read_leaves=folder.read_leaves,
        read_runs=folder.read_runs,
        files=folder.files,
    ),
    Format(
        name="compressed-ply",
        description="PlayCanvas, 16 to 61 bytes",
        suffixes=(".compressed.ply",),
        versions="with and without colour ranges",
        holds=Holds(),
        sniff=compressed_ply.sniff,
        read=compressed_ply.read,
        write_chunks=compressed_ply.write_chunks,
        read_chunks=compressed_ply.read_chunks,
    ),
    Format(
        name="ply",
        description="3DGS training output",
        suffixes=(".ply",),
        versions="text, binary",
        holds=Holds(lossless=True, origin=True),
        sniff=ply.sniff,
        read=ply.read,
        write_chunks=ply.write_chunks,
        read_chunks=ply.read_chunks,
    ),
    Format(
        name="splat",
        may_be_empty=True,
        description="antimatter15, 32 bytes",
        suffixes=(".splat",),
        versions="-",
        holds=Holds(sh_degree=0, modes=("classic",)),
        sniff=splat.sniff,
        read=splat.read,
        write_chunks=splat.write_chunks,
        read_chunks=splat.read_chunks,
    ),
    Format(
        name="spz",
        description="Niantic SPZ, 24 to 65 bytes",
        suffixes=(".spz",),
        versions="1-4 (written: 2-4)",
        holds=Holds(axes="RUB or as a record says"),
        sniff=spz.sniff,
        read=spz.read,
        write_chunks=spz.write_chunks,
        read_chunks=spz.read_chunks,
        options=("format_version", "sh_bits", "compression", "axes"),
    ),
    Format(
        name="gltf",
        description="KHR_gaussian_splatting, plain or SPZ",
        suffixes=(".glb",),
        versions="2.0; SPZ 1-4 (written: 2-4)",
        holds=Holds(origin=True, axes="LUF"),
        sniff=gltf.sniff,
        read=gltf.read,
        read_chunks=gltf.read_chunks,
        files=gltf.files,
        write_chunks=glb_writer.write_chunks,
        options=("packing", "format_version", "sh_bits", "compression"),
    ),
    Format(
        name="sog",
        description="PlayCanvas SOG",
        suffixes=(".sog",),
        is_zip=True,
        versions="1, 2 (2)",
        holds=Holds(),
        sniff=sog.sniff,
        read=sog.read,
        write_chunks=sog_writer.write_chunks,
        write_folder=sog_writer.write_folder,
        files=sog.files,
        read_chunks=sog.read_chunks,
        options=("sh_palette", "iterations"),
    ),
    Format(
        name="streamed-sog",
        description="PlayCanvas streamed SOG",
        suffixes=(),
        versions="1",
        holds=Holds(levels="one of"),
        sniff=streamed_sog.sniff,
        read=streamed_sog.read,
        read_chunks=streamed_sog.read_chunks,
        files=streamed_sog.files,
    ),
    Format(
        name="3d-tiles",
        description="OGC 3D Tiles of glTF",
        suffixes=(),
        versions="1.0, 1.1",
        holds=Holds(axes="LUF, z up"),
        sniff=tiles3d.sniff,
        read=tiles3d.read,
        read_chunks=tiles3d.read_chunks,
        files=tiles3d.files,
    ),
    Format(
        name="ksplat",
        description="GaussianSplats3D",
        suffixes=(".ksplat",),
        versions="0.1, levels 0-2",
        holds=Holds(sh_degree=2, modes=("classic",)),
        sniff=ksplat.sniff,
        read=ksplat.read,
        write_chunks=ksplat_writer.write_chunks,
        read_chunks=ksplat.read_chunks,
        options=("compression",),
    ),
    Format(
        name="hier",
        description="Hierarchical 3DGS, with levels",
        suffixes=(".hier",),
        versions="float32, half",
        holds=Holds(levels="tree", modes=("classic",)),
        sniff=hier.sniff,
        read=hier.read,
        read_leaves=hier.read_leaves,
        read_runs=hier.read_runs,
        whole_bytes=hier.whole_bytes,
        write=hier.write,
        options=("compression",),
    ),
    Format(
        name="rad",
        description="Spark, with levels",
        suffixes=(".rad",),
        versions="1",
        holds=Holds(levels="tree", threshold=True, record=True),
        sniff=rad.sniff,
        read=rad.read,
        write=rad_writer.write,
        write_chunks=rad_writer.write_chunks,
        read_chunks=rad.read_chunks,
        options=("compression",),
    ),
)


def formats() -> tuple[Format, ...]:
    """All formats, in the order in which they are tried."""
    return FORMATS


def format_to_write(target: Path) -> Format:
    """The format that the suffix of a new file names.

    Raises:
        InputError: no format that is written has it.
    """
    written = [f for f in FORMATS if f.is_written]
    # The longest suffix wins: .compressed.ply is not .ply.
    named = [(len(suffix), f) for f in written for suffix in f.suffixes if target.name.lower().endswith(suffix)]
    if target.name == FOLDER_FILE:
        named = [(0, f) for f in written if f.write_folder is not None]
    if not named:
        known = " ".join(suffix for f in written for suffix in f.suffixes)
        raise InputError(
            f"{target}: cannot be written, its suffix is {target.suffix!r}; wanted one of {known}, or FOLDER/{FOLDER_FILE} for "
            "a folder of SOG"
        )
    return max(named, key=lambda item: item[0])[1]


def detect(path: Path) -> Format | None:
    """The format of a file or folder: by content, else by suffix; None if it is of none.

    Raises:
        InputError: it is there but may not be read.
    """
    path = located(path)
    try:
        head = b""
        if path.is_file():
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
        for f in FORMATS:
            if f.sniff(path, head):
                return f
        if path.is_file():
            named = next((f for f in FORMATS if f.suffixes and path.name.lower().endswith(f.suffixes)), None)
            if named is not None:
                content = not_content(head) or (None if named.is_zip else packed(head))
                if content and not (named.may_be_empty and not head):
                    raise FormatError(f"{path}: {content}")
            return named
    except OSError as error:
        if isinstance(error, SplatreeError):
            raise
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    return None


def stored_bytes(path: Path) -> int:
    """Bytes of the files that a path of a known format stands for: of a folder or its meta.json, all that it names."""
    path = located(path)
    try:
        if not path.exists():  # it was fetched from elsewhere
            return 0
    except InputError:
        if is_fetched_whole(path):  # whose server does not say
            return 0
        raise
    return sum(file.stat().st_size for file in files_of(path))


def files_of(path: Path) -> list[Path]:
    """The files that a path of a known format stands for."""
    path = located(path)
    if is_fetched_whole(path):
        return [path]
    found = detect(path)
    return [path] if found is None or found.files is None else found.files(path)
