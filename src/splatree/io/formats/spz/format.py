"""``.spz`` (Niantic): quantised columns one after the other, versions 1 to 4. https://github.com/nianticlabs/spz

=========  ==========  =====================================================================================
plane      bytes       code
=========  ==========  =====================================================================================
positions  9 (6 v1)    three fixed-point numbers of 24 bits (v1: three f2)
alphas     1           255 opacity
colors     3           127.5 + 0.15 · 255 dc
scales     3           16 (log-scale + 10)
rotations  4 (3 v1-2)  smallest three of x, y, z, w: place of the largest, then sign and 9 bits each (v1-2: x, y, z)
harmonics  3 (k − 1)   128 + 128 sh, coefficient by coefficient with RGB inside, to multiples of 4 and 8 by default
=========  ==========  =====================================================================================

A file is read and written chunk by chunk (`spz/container.py`). zlib and zstandard do the compression, the native core
the codes: for a million Gaussians of degree 3 the codes take 0.1 s, zstd 0.5 s of a processor.

The axes of a file are RUB by the format's documents, but RDF, those of the .ply, in the files of nearly every converter. We
write RDF and name it in the extension record that the format has for this. A file without the record is taken for RUB if its
scene is a thing that stands on y = 0 with y up (`y_of_a_thing`), else for RDF. docs/reference/formats/spz.md.
"""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from splatree.constants import SH_MAX_DEGREE
from splatree.errors import InputError
from splatree.io.check import LOGIT_FROM_BYTE, magnitudes_of, refuse_unusable
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.spz.container import GZIP_MAGIC, MAGIC, Header, Planes
from splatree.io.formats.spz.plane_writer import PlaneWriter
from splatree.io.formats.spz.versions import DEFAULT_VERSION, VERSIONS
from splatree.io.mirror import mirror
from splatree.io.notes import gaussians_in_words
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows, Fill, columns_to_fill
from splatree.kernels.cpu.codec import quantize
from splatree.maths.axes import harmonic_signs, quat_signs, signs_between, y_of_a_thing
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array

SCENE_AXES: Final = "RDF"
"""Axes of our scenes, those of training output."""

_POSITION_MAX = (1 << 23) - 1
"""Largest fixed-point number."""

_FRACTIONAL_BITS = 12
"""Of positions, where they fit: the choice of the format's own writer, a step of 0.24 mm in scenes measured in metres."""

_FRACTIONAL_BITS_MAX = 16
"""Of positions of small things: steps of a third of e^-10, the smallest scale that the format holds."""

_STEP_MAX = 0.25
"""Step of positions in standard deviations of the median Gaussian, above which a thing is small: means move by an eighth."""

_LOOKED_AT = 100_000
"""Rows whose means are looked at where a file does not name its axes: quantiles then err by a few tenths of a percent."""

_COLOR_SCALE = 0.15 * 255
_SH_BITS = 5
"""Bits of harmonics above degree 1, which gets one more: 42 dB in a near view of a city. The format's own writer keeps 4 and 5:
37 dB, and a file smaller by a tenth."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file begins with the magic of version 4, or with gzip around it."""
    if head[:2] == GZIP_MAGIC:
        import zlib

        try:
            return zlib.decompressobj(31).decompress(head, 4) == MAGIC
        except zlib.error:
            return path.suffix.lower() == ".spz"
    return head[:4] == MAGIC


def read(path: Path, options: ReadOptions) -> Scene:
    """Read a file of version 1 to 4; harmonics of degree 4 are dropped."""
    return _open(path, options).scene(options)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """The same values in chunks; of versions 1 to 3 all codes are kept (`spz/container.py`)."""
    return _open(path, options).chunks(options)


def _open(path: Path, options: ReadOptions) -> FileRows:
    return file_rows(lambda: path.open("rb"), path.stat().st_size, str(path), default_axes=options.axes)


def file_rows(open_file: Callable[[], BinaryIO], num_bytes: int, where: str, *, default_axes: str | None) -> FileRows:
    """The Gaussians of an .spz of ``num_bytes`` in a file that can be opened again, in the axes of our scenes.

    ``default_axes`` are those of a file that names none; None: what its place says.
    """
    with open_file() as file:
        planes = Planes(file, num_bytes, where)
        axes, named = planes.axes or default_axes, planes.axes or f"{default_axes}, as told"
        notes: list[str] = []
        if axes is None:
            axes, named = _axes_by_place(planes, file)
            notes = [f"the .spz does not name its axes: {named}; --input-axes says otherwise"]
    header = planes.header
    degree = min(header.sh_degree, SH_MAX_DEGREE)
    signs = signs_between(axes, SCENE_AXES)

    @contextmanager
    def start() -> Iterator[Fill]:
        with open_file() as file:
            take = planes.open(file)

            def fill(begin: int, out: Gaussians) -> None:
                for name, data in take(len(out)):
                    _decode(header, name, np.frombuffer(data, np.uint8).reshape(len(out), -1), out)
                mirror(out, signs)

            yield fill

    metadata = {"version": str(header.version), "axes": named}
    if notes:
        metadata["notes"] = json.dumps(notes)
    if header.sh_degree > SH_MAX_DEGREE:
        metadata["lost"] = json.dumps(
            [f"the harmonics of degree {header.sh_degree}: a scene holds no more than {SH_MAX_DEGREE}"]
        )
    mode: Mode = "antialiased" if header.antialiased else "classic"
    return FileRows(where, header.num_gaussians, degree, start, mode, metadata)


def _axes_by_place(planes: Planes, file: BinaryIO) -> tuple[str, str]:
    """The axes of a file that names none, and why: RUB if its scene stands on y = 0 with y up, else RDF."""
    header = planes.header
    stride = max(1, header.num_gaussians // _LOOKED_AT)
    take, means = planes.open(file), [np.empty((0, 3), np.float32)]
    for begin in range(0, header.num_gaussians, ROWS_PER_CHUNK):
        part = columns_to_fill(min(ROWS_PER_CHUNK, header.num_gaussians - begin), 0)
        name, data = next(take(len(part)))  # positions are the first plane
        _decode(header, name, np.frombuffer(data, np.uint8).reshape(len(part), -1), part)
        means.append(part.means[::stride].copy())
    if y_of_a_thing(np.concatenate(means)) > 0:
        return "RUB", "RUB, as the scene stands on y = 0"
    return SCENE_AXES, f"{SCENE_AXES}, assumed"


def _decode(header: Header, plane: str, codes: Array, out: Gaussians) -> None:
    """Fill the column that a plane is of."""
    sh = out.sh.reshape(len(out), -1)
    match plane:
        case "positions" if header.version == 1:
            out.means[:] = codes.view("<f2")
        case "positions":
            quantize.means_from_fixed(codes, out.means, scale=2.0**-header.fractional_bits)
        case "alphas":
            np.take(LOGIT_FROM_BYTE, codes[:, 0], out=out.logit_opacities, mode="clip")  # all codes are in the table
        case "colors":
            quantize.values_from_bytes(codes, sh, scale=1 / _COLOR_SCALE, offset=-0.5 / 0.15)
        case "scales":
            quantize.values_from_bytes(codes, out.log_scales, scale=1 / 16, offset=-10)
        case "rotations":
            quantize.quats_from_codes(codes, out.quats)
        case _:
            kept = np.ascontiguousarray(codes[:, : sh.shape[1] - 3])  # degree 4 is cut off
            quantize.values_from_bytes(kept, sh, scale=1 / 128, offset=-1, skip=3)


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write a file in one pass, or in two where the means are too far out for the fractional bits that their sizes ask for."""
    version = DEFAULT_VERSION if options.format_version is None else options.format_version
    if version not in VERSIONS:
        raise InputError(f"{path}: found version {version}, wanted 2, 3 or 4 of .spz")
    codec, level_max = ("zstd", 22) if version == 4 else ("gzip", 9)
    if options.compression is not None and not 1 <= options.compression <= level_max:
        raise InputError(
            f"{path}: found compression {options.compression}, wanted 1 to {level_max}, a level of {codec}"
        )
    with path.open("wb") as file:
        return encode(chunks, file, path, version=version, axes=options.axes or SCENE_AXES, options=options)


def encode(
    chunks: Chunks,
    file: BinaryIO,
    path: Path,
    *,
    version: int,
    axes: str | None,
    options: WriteOptions,
    unnamed_axes: str = "RUB",
) -> tuple[str, ...]:
    """Write an .spz to an open file; return what was lost. ``axes`` None: ``unnamed_axes``, without a record that says so.

    ``path`` is named in errors and progress, its folder holds temporary files.
    """
    bits: int | None = _fractional_bits(chunks)
    while bits is not None:
        header = Header(version, len(chunks), chunks.sh_degree, bits, chunks.mode == "antialiased", axes)
        with PlaneWriter(header, path.parent, options.compression) as writer:
            encoder = _Encoder(header, signs_between(SCENE_AXES, axes or unnamed_axes), options.sh_bits)
            bits = encoder.run(chunks, writer, path)
            if bits is None:
                writer.finish(file)
    return encoder.losses()


def _fractional_bits(chunks: Chunks) -> int:
    """12, or more for a small thing, by the median of the longest standard deviations in its first chunk."""
    first = next(iter(chunks), None)
    if first is None or not len(first):
        return _FRACTIONAL_BITS
    size = float(np.median(first.log_scales.max(axis=1)))
    wanted = math.ceil(-(size + math.log(_STEP_MAX)) / math.log(2)) if math.isfinite(size) else 0
    return min(max(wanted, _FRACTIONAL_BITS), _FRACTIONAL_BITS_MAX)


class _Encoder:
    """Chunks to codes, in buffers of its own, and a count of what does not fit."""

    def __init__(self, header: Header, signs: Array, sh_bits: int | None) -> None:
        self._header, self._signs = header, signs
        bits = _SH_BITS if sh_bits is None else sh_bits
        if not 1 <= bits <= 8:
            raise InputError(f"spz: found {bits} bits of harmonics, wanted 1 to 8")
        k = (header.sh_degree + 1) ** 2
        self._step = np.where(np.arange(3 * (k - 1)) < 9, 1 << 8 - min(8, bits + 1), 1 << 8 - bits)
        self._sh_signs = np.repeat(harmonic_signs(signs, header.sh_degree)[1:], 3)
        self._buffers = {name: np.empty((0, width), np.uint8) for name, width in header.planes().items()}
        self._clamped = dict.fromkeys(("scales", "colours", "harmonics"), 0)

    def run(self, chunks: Chunks, writer: PlaneWriter, path: Path) -> int | None:
        """Hand the codes of all chunks to the writer; or return how many fractional bits a chunk asks for, if it is fewer."""
        begin = 0
        with task(f"write {path.name}", len(chunks)) as advance:
            for g in chunks:
                magnitudes = magnitudes_of(g)
                refuse_unusable(g, "scene to write", magnitudes=magnitudes, first_row=begin)
                largest = magnitudes["means"]
                bits = self._header.fractional_bits
                while largest * 2.0**bits > _POSITION_MAX:
                    bits -= 1
                if bits < 0:
                    raise InputError(
                        f"{path}: found a mean of magnitude {largest:g}, wanted at most {_POSITION_MAX} in an .spz; "
                        "move or scale the scene, or choose another format"
                    )
                if bits < self._header.fractional_bits:
                    return bits
                for name, codes in self._codes(g):
                    writer.put(name, codes)
                self._count_clamped(g, magnitudes["sh"])
                begin += len(g)
                advance(len(g))
        return None

    def _codes(self, g: Gaussians) -> Iterator[tuple[str, Array]]:
        """Codes of each plane, valid until the next chunk."""
        sh = g.sh.reshape(len(g), -1)
        for name, buffer in self._buffers.items():
            if len(buffer) < len(g):
                self._buffers[name] = buffer = np.empty((len(g), buffer.shape[1]), np.uint8)
            codes = buffer[: len(g)]
            match name:
                case "positions":
                    scale = 2.0**self._header.fractional_bits
                    quantize.fixed_from_means(g.means, codes, signs=self._signs, scale=scale)
                case "alphas":
                    quantize.bytes_from_logits(g.logit_opacities, codes.reshape(-1))
                case "colors":
                    quantize.bytes_from_values(sh, codes, scale=_COLOR_SCALE, offset=127.5)
                case "scales":
                    quantize.bytes_from_values(g.log_scales, codes, scale=16, offset=160)
                case "rotations":
                    quantize.codes_from_quats(g.quats, codes, signs=quat_signs(self._signs))
                case _:
                    scales = 128 * self._sh_signs
                    quantize.bytes_from_values(sh, codes, scale=scales, offset=128, step=self._step, skip=3)
            yield name, codes

    def _count_clamped(self, g: Gaussians, largest: float) -> None:
        """Count rows with values beyond the range of their codes, by more than half a step."""
        outside = (g.log_scales < -10 - 1 / 32) | (g.log_scales > 95 / 16 + 1 / 32)
        self._clamped["scales"] += int(outside.any(axis=1).sum())
        if largest > 1:
            self._clamped["colours"] += int((np.abs(g.sh[:, 0]) > 128 / _COLOR_SCALE).any(axis=1).sum())
            if "harmonics" in self._buffers:
                codes = self._buffers["harmonics"][: len(g)]  # the ends of the range mark the rows to look at
                rows = np.flatnonzero((codes.min(axis=1) == 0) | (codes.max(axis=1) == 255))
                self._clamped["harmonics"] += int((np.abs(g.sh[rows, 1:]) > 1 + 1 / 256).any(axis=(1, 2)).sum())

    def losses(self) -> tuple[str, ...]:
        """What does not fit, a sentence each."""
        ranges = {"scales": "e^-10 to e^5.94", "colours": "−0.44 to 1.44 (dc ± 3.33)", "harmonics": "±1"}
        lost = [
            f"{what} outside of {ranges[what]}: clamped in {gaussians_in_words(count)}"
            for what, count in self._clamped.items()
            if count
        ]
        if self._header.fractional_bits < _FRACTIONAL_BITS:
            lost.append(
                f"precision of means: some are so far out that all are kept to steps of {2.0**-self._header.fractional_bits:g} "
                f"(else {2.0**-_FRACTIONAL_BITS:g})"
            )
        return tuple(lost)
