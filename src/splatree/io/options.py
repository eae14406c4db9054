"""What a caller may ask of readers and writers; the command line's help is these docstrings."""

from dataclasses import dataclass, fields
from typing import Literal

from splatree.errors import InputError
from splatree.io.memory import SMALLEST_MEMORY, bytes_of
from splatree.maths.axes import AxesName
from splatree.scene.literals import check_literals

Repair = bool | Literal["drop"]
"""What is done with values that cannot be used: False raises; True fixes or drops; "drop" drops all rows that have any."""


Packing = Literal["spz"]
"""What a .glb may hold in place of plain values."""


@dataclass(frozen=True)
class ReadOptions:
    """How a file is read.

    Example:
        >>> st.ConvertOptions(read=st.ReadOptions(repair=True)).read.repair
        True
    """

    level: int | None = None
    """Level of detail to read from a format that has several, 0 the finest; None: 0. An error for other formats."""
    repair: Repair = False
    """Repair or drop values that cannot be used, and count them, instead of raising; "drop" drops every row that has one."""
    axes: AxesName | None = None
    """Where x, y and z point in an .spz file that does not say so: left or right, up or down, front or back; None: RDF, as in a
    .ply, or RUB for a thing that stands on y = 0."""
    ignore_properties: bool = False
    """Read a file whose other properties would change the picture (motion, other kernels), and say what is lost, instead of
    raising."""

    def __post_init__(self) -> None:
        check_literals(self)


@dataclass(frozen=True)
class WriteOptions:
    """How a file is written. None leaves the choice to the format. An option that the chosen format does not take is an error.

    Example:
        >>> lost = st.write(scene, "coarse.spz", options=st.WriteOptions(sh_bits=4), depth=1, force=True)
        >>> "precision: spz rounds values to steps of its own" in lost
        True
    """

    format_version: int | None = None
    """Version of the format, where several can be written: 2, 3 or 4 of .spz, where `--spz-version` is the same."""
    sh_bits: int | None = None
    """Bits of a harmonic beyond the DC, in SPZ: of degrees 2 and 3; degree 1 gets one bit more."""
    sh_palette: int | None = None
    """Entries of the palette of harmonics, in SOG: more entries are nearer to the scene, and take longer to find."""
    iterations: int | None = None
    """Rounds of K-means for palettes and codebooks."""
    compression: int | None = None
    """Level of compression, where the format defines levels."""
    compact: bool = False
    """Round the values of a .splatree, its levels included: hardly larger than a .sog of the leaves."""
    axes: AxesName | None = None
    """Where x, y and z shall point in the file, where the format leaves that open; None: as in the scene, RDF."""

    max_memory: str | None = None
    """Memory that a conversion may take, such as 500M: what needs more waits in files, and the output is the same. None: half of
    what is free."""
    packing: Packing | None = None
    """How values are packed in a .glb: `spz`; None: plain."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.max_memory is not None and bytes_of(self.max_memory) < SMALLEST_MEMORY:
            raise InputError(f"max_memory: found {self.max_memory}, wanted at least {SMALLEST_MEMORY // 10**6}M")

    def given(self) -> dict[str, int | str]:
        """The options of the format that are not left to it."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "max_memory"}
        return {name: value for name, value in values.items() if value is not None and value is not False}

    def check_taken(self, taken: tuple[str, ...], where: str) -> None:
        """Refuse options that the chosen format does not take."""
        for name, value in self.given().items():
            if name not in taken:
                known = f"only {', '.join(taken)}" if taken else "none"
                raise InputError(f"{where}: found the option {name} = {value}, but this format takes {known}")
