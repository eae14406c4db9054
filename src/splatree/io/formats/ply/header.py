"""The text at the head of a .ply: how its vertices are encoded, what they hold, and what other tools noted in comments."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from splatree.errors import FormatError
from splatree.scene.names import Mode

__all__ = ["HEADER_MAX", "Element", "Encoding", "Header", "Text", "parse_header", "parse_text"]

HEADER_MAX = 1 << 20
"""A longer header is refused: 62 properties take 1.5 kB."""

Encoding = Literal["binary_little_endian", "binary_big_endian", "ascii"]
"""How values are written."""

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass
class Element:
    """A table of the file."""

    name: str
    """Its name."""
    count: int
    """Rows announced."""
    properties: list[tuple[str, str]]
    """Name and NumPy type of each value of a row that is no list."""
    lists: dict[int, tuple[str, str]] = field(default_factory=dict)
    """NumPy types of the count and of the items of each list, by its place among all properties."""

    @property
    def has_lists(self) -> bool:
        """Whether some values are lists, which `properties` leaves out."""
        return bool(self.lists)

    @property
    def num_bytes(self) -> int:
        """Bytes of all rows, without lists."""
        return self.count * np.dtype(self.properties).itemsize


_PREFIXES = re.compile(r"^(scal(ar)?_|diffuse_)+")
_SPELLINGS = {"filter_3d": "filter_3D", "filter3d": "filter_3D"}
_LETTERS = {"r": "red", "g": "green", "b": "blue"}


@dataclass(frozen=True)
class Header:
    """What the header says of the vertices."""

    encoding: Encoding
    """How values are written."""
    start: int
    """Byte of the first element."""
    lines_before: int
    """Lines of a text file between there and the first vertex: the elements before it."""
    lines_after: int
    """Lines of a text file behind the last vertex: the elements after it."""
    count: int
    """Vertices announced."""
    dtype: np.dtype[np.void]
    """A vertex."""
    names: dict[str, str]
    """Property by its usual name (`_by_usual_name`)."""
    before: list[Element]
    """Elements before the vertices."""
    others: list[str]
    """The elements that are not vertices and have rows, in words."""
    bytes_after: int | None
    """Bytes of the elements behind the vertices; None if they hold lists."""
    mode: Mode
    """As noted in a comment, else classic."""
    are_surfels: bool
    """Whether a comment says that these are surfels (2DGS)."""
    comments: list[str]
    """The other comments."""


@dataclass(frozen=True)
class Text:
    """The header as it is written."""

    encoding: Encoding
    """How values are written."""
    num_bytes: int
    """Bytes of the header."""
    elements: list[Element]
    """The tables, in their order."""
    mode: Mode
    """As noted in a comment, else classic."""
    are_surfels: bool
    """Whether a comment says that these are surfels (2DGS)."""
    comments: list[str]
    """The other comments."""


def parse_text(path: Path, head: bytes) -> Text:
    """The tables and comments that the first bytes of a file announce.

    Raises:
        FormatError: the header is not whole or not of a .ply.
    """
    match = re.search(rb"(?:^|\n)end_header[ \t]*\r*\n", head)
    if not match and b"\n" not in head.partition(b"end_header")[0]:  # lines of old Macintoshes
        match = re.search(rb"(?:^|\r)end_header[ \t]*\r", head)
    if not match:
        raise FormatError(f"{path}: found no end_header in its first {len(head)} bytes; the file is damaged or cut off")
    try:
        text = head[: match.start()].decode("utf-8")
    except UnicodeDecodeError:  # comments of older tools are in Latin-1
        text = head[: match.start()].decode("latin-1")
    lines = [line.strip() for line in re.split(r"\r*\n|\r", text)]

    encoding = next((line.split()[1] for line in lines if re.match(r"format\s+\S", line)), "missing")
    if encoding not in get_args(Encoding):
        raise FormatError(f"{path}: found format {encoding!r}, wanted one of {', '.join(get_args(Encoding))}")
    order = ">" if encoding == "binary_big_endian" else "<"
    comments: list[str] = []
    elements: list[Element] = []
    for line_number, line in enumerate(lines[1:], start=2):
        match line.split():
            case [] | ["format", *_]:
                pass
            case ["comment" | "obj_info", *_]:
                comments.append(line.partition(" ")[2])
            case ["element", name, digits] if digits.isascii() and digits.isdigit() and len(digits) < 16:
                elements.append(Element(name, int(digits), []))
            case ["property", "list", number, kind, _] if elements and number in _TYPES and kind in _TYPES:
                place = len(elements[-1].properties) + len(elements[-1].lists)
                elements[-1].lists[place] = order + _TYPES[number], order + _TYPES[kind]
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, order + _TYPES[kind]))
            case _:
                raise FormatError(
                    f"{path}: line {line_number} of the header, {line!r}: wanted 'element NAME COUNT' or 'property TYPE "
                    "NAME' with a scalar type"
                )
    for element in elements:
        names = [name for name, _ in element.properties]
        if len(set(names)) != len(names):
            raise FormatError(f"{path}: element {element.name!r} has two properties of the same name")
    mode, are_surfels, rest = _notes(path, comments)
    return Text(encoding, match.end(), elements, mode, are_surfels, rest)  # type: ignore[arg-type]  # checked above


def parse_header(path: Path, head: bytes) -> Header:
    """The header in the first bytes of a file.

    Raises:
        FormatError: it is not whole, not of a .ply, or its vertices cannot be Gaussians.
    """
    text = parse_text(path, head)
    elements = text.elements
    index = _vertices(path, elements)
    before, vertices, after = elements[:index], elements[index], elements[index + 1 :]
    names = [name for name, _ in vertices.properties]
    return Header(
        encoding=text.encoding,
        start=text.num_bytes,
        lines_before=_num_lines(before),
        lines_after=_num_lines(after),
        count=vertices.count,
        dtype=np.dtype(vertices.properties),
        names=_by_usual_name(names),
        before=before,
        others=[f"{e.name} ({e.count:,} row{'s' * (e.count != 1)})" for e in (*before, *after) if e.count],
        bytes_after=None if any(e.has_lists and e.count for e in after) else sum(e.num_bytes for e in after),
        mode=text.mode,
        are_surfels=text.are_surfels,
        comments=text.comments,
    )


def _num_lines(elements: list[Element]) -> int:
    """Lines of elements in a text; a row of nothing is an empty line, which does not count."""
    return sum(element.count for element in elements if element.properties or element.lists)


def _by_usual_name(names: list[str]) -> dict[str, str]:
    """Properties by the name that 3DGS gives them, and by their own.

    CloudCompare writes scalar_opacity or scal_opacity for opacity, others diffuse_red or r for red, filter_3d for filter_3D.
    """
    usual = {}
    for name in names:
        bare = _PREFIXES.sub("", name)
        usual[_SPELLINGS.get(bare.lower(), bare)] = name
    if set(_LETTERS) <= set(names):
        usual |= {_LETTERS[letter]: letter for letter in _LETTERS if _LETTERS[letter] not in names}
    return usual | {name: name for name in names}


def _vertices(path: Path, elements: list[Element]) -> int:
    """Index of the element that holds the Gaussians."""
    names = [element.name for element in elements]
    if "codebook_centers" in names:
        raise FormatError(
            f"{path}: found the element codebook_centers: values are indices into a codebook (reduced-3dgs), wanted floats; "
            "load it with the program that wrote it and save it without quantisation"
        )
    if "vertex" not in names:
        raise FormatError(f"{path}: found elements {names}, wanted one named 'vertex'")
    index = names.index("vertex")
    if elements[index].has_lists:
        raise FormatError(f"{path}: the vertices hold lists, wanted scalars: this is no 3DGS file")
    return index


def _notes(path: Path, comments: list[str]) -> tuple[Mode, bool, list[str]]:
    """Mode and surfels, as Brush and splat-transform (SplatRenderMode) or Postshot (antialiased 0/1) note them; the rest."""
    mode: Mode = "classic"
    are_surfels = False
    rest = []
    for comment in comments:
        match comment.lower().split():
            case ["splatrendermode:", "default"] | ["antialiased", "0"]:
                mode = "classic"
            case ["splatrendermode:", "mip"] | ["antialiased", "1"]:
                mode = "antialiased"
            case ["splatrendermode:", "2dgs"]:
                are_surfels = True
            case ["splatrendermode:", other, *_]:
                raise FormatError(f"{path}: found SplatRenderMode {other!r}, wanted 'default', 'mip' or '2dgs'")
            case _:
                rest.append(comment)
    return mode, are_surfels, rest
