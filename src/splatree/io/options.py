"""What a caller may ask of readers and writers; the command line's help is these docstrings."""

from dataclasses import dataclass, fields
from typing import Literal

from splatree.errors import InputError
from splatree.maths.axes import AxesName
from splatree.scene.literals import check_literals

Repair = bool | Literal["drop"]
"""What is done with values that cannot be used: False raises; True fixes or drops; "drop" drops all rows that have any."""


Packing = Literal["spz"]
"""What a .glb may hold in place of plain values."""


@dataclass(frozen=True)
class ReadOptions:
    """How a file is read."""

    level: int | None = None
    """Level of detail to read from a format that has several, 0 the finest; None: 0. An error for other formats."""
    repair: Repair = False
    """Fix or drop what is wrong by the rules of `splatree.io.check`, and count it, instead of raising."""
    axes: AxesName | None = None
    """Where x, y and z point in a file whose format leaves that open and that does not name it itself (left or right, up or down,
    front or back); None: RDF, as in a .ply."""
    ignore_properties: bool = False
    """Read a file whose other properties would change the picture (motion, other kernels), and say what is lost, instead of
    raising."""

    def __post_init__(self) -> None:
        check_literals(self)


@dataclass(frozen=True)
class WriteOptions:
    """What some formats are told when they are written. None leaves the choice to the format; an option that the chosen format
    does not take is an error."""

    format_version: int | None = None
    """Version of the format to write, where there are several."""
    sh_bits: int | None = None
    """Bits of a harmonic beyond the DC, where the format leaves them open (SPZ: of degree 2 and 3, degree 1 gets one more)."""
    sh_palette: int | None = None
    """Entries of the palette of harmonics, where the format has one: more are nearer to the scene, and slower to find."""
    iterations: int | None = None
    """Rounds of K-means for palettes and codebooks."""
    compression: int | None = None
    """Level of compression, where the format defines levels."""
    axes: AxesName | None = None
    """Where x, y and z shall point in the file, where the format leaves that open; None: as in the scene, RDF."""

    packing: Packing | None = None
    """How values are packed, in a format that leaves it open; None: not at all."""

    def __post_init__(self) -> None:
        check_literals(self)

    def given(self) -> dict[str, int | str]:
        """The options that are not None."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    def check_taken(self, taken: tuple[str, ...], where: str) -> None:
        """Refuse options that the format at hand does not take."""
        for name, value in self.given().items():
            if name not in taken:
                known = f"only {', '.join(taken)}" if taken else "none"
                raise InputError(f"{where}: found the option {name} = {value}, but this format takes {known}")
