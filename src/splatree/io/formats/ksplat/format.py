"""``.ksplat`` (GaussianSplats3D): sections of fixed records, as floats (level 0) or in 16 and 8 bits (levels 1 and 2).

A header of 4096 bytes, 1024 bytes for each section, then each section: the lengths of its partly filled buckets, the centres
of its buckets, its records.

======  ==================================  ===============================================================
column  level 0                             levels 1 and 2
======  ==================================  ===============================================================
mean    3 f4                                3 u2: bucket centre + (u − range) · (block size / 2) / range
scale   3 f4, linear                        3 f2, linear
quat    4 f4 wxyz                           4 f2 wxyz
RGBA    4 u1: ½ + C0 dc, and the opacity    the same
rest    f4                                  f2 (level 1), u1 between the header's minimum and maximum (level 2)
======  ==================================  ===============================================================

Harmonics go degree by degree, and within a degree channel by channel: 3 of red, 3 of green, 3 of blue, then 5 of red and so on.
Degrees 0 to 2 are written, as the format's own viewer has no third; a third is read. docs/reference/formats/ksplat.md.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError, InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.opacities import CODE_STEP, logits_from_opacities, opacities_from_logits
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.rows import FileRows, Fill
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array

_HEADER_BYTES, _SECTION_BYTES = 4096, 1024
_HEADER = np.dtype(
    {
        "names": ["major", "minor", "max_sections", "sections", "max_rows", "rows", "level", "centre", "rest_range"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u4", "<u4", "<u2", ("<f4", 3), ("<f4", 2)],
        "offsets": [0, 1, 4, 8, 12, 16, 20, 24, 36],
        "itemsize": _HEADER_BYTES,
    }
)
_SECTION = np.dtype(
    {
        "names": [
            *("rows", "max_rows", "bucket_rows", "buckets", "block_size", "bucket_bytes"),
            *("code_range", "bytes", "full_buckets", "partial_buckets", "degree"),
        ],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40],
        "itemsize": _SECTION_BYTES,
    }
)
_REST_RANGE = (-1.5, 1.5)
"""Range of the harmonics of level 2 where the header says 0."""

_CODE_RANGE = 32767
"""Steps from a bucket's centre to the side of its block."""

_BUCKET_ROWS = 256
_BLOCK_SIZE = 5.0
"""Side of a block, world units, that the format's tools write; ours is smaller in scenes of small Gaussians …"""

_BLOCK_SIZE_IN_SIGMAS = 1310.0
"""… at most this many times the median standard deviation, so that a step is at most 2 % of it."""

_SAMPLE = 1 << 16
"""Rows, evenly spread, of which the median is taken."""

_HALF_MAX = 65504.0
_HALF_MIN = 2.0**-24
"""Smallest half-precision number above 0; a scale of 0 stands for one below half of it."""

_CLIP_MIN = 0.5 / 255
"""A colour that is clipped by less is only rounded."""

_SHARE = np.arange(256) / 255
_LOGITS = logits_from_opacities(_SHARE, step_low=CODE_STEP, step_high=CODE_STEP)
_COLORS = ((_SHARE - 0.5) / SH_C0).astype(np.float32)
"""What bytes of opacity and of colour stand for."""


def _record(level: int, degree: int) -> np.dtype[np.void]:
    num_rest = 3 * ((degree + 1) ** 2 - 1)
    mean, other, rest = [("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1")][level]
    return np.dtype(
        [("mean", mean, 3), ("scale", other, 3), ("quat", other, 4), ("rgba", "u1", 4), ("rest", rest, num_rest)]
    )


def _rest_order(degree: int) -> Array:
    """Where each harmonic beyond the DC of a record lies in coefficients with RGB inside."""
    places = [
        3 * (order * order + j - 1) + channel
        for order in range(1, degree + 1)
        for channel in range(3)
        for j in range(2 * order + 1)
    ]
    return np.array(places, np.intp)


@dataclass(frozen=True)
class _File:
    """What the headers say, checked against the size of the file."""

    level: int
    rest_range: tuple[float, float]
    sections: Array  # of _SECTION
    starts: list[int]  # byte of each section

    @property
    def degree(self) -> int:
        return int(self.sections["degree"].max(initial=0))


def sniff(path: Path, head: bytes) -> bool:
    """Whether the headers fit the size of the file to the byte: the only mark is a version of 0.1."""
    if len(head) < _HEADER_BYTES or head[:4] != b"\x00\x01\x00\x00" or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            _parse(path, file)
    except FormatError:
        return False
    return True


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all sections, one after the other, at the highest degree among them."""
    return _open(path).scene(options)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """The same values in chunks."""
    return _open(path).chunks(options)


def _open(path: Path) -> FileRows:
    with path.open("rb") as file:
        found = _parse(path, file)
        sections = [
            _Section(file, found, section, start, f"{path}: section {number}")
            for number, (section, start) in enumerate(zip(found.sections, found.starts, strict=True))
        ]
    ends = np.cumsum([section.num_rows for section in sections], dtype=np.int64)

    @contextmanager
    def start() -> Iterator[Fill]:
        with path.open("rb") as file:

            def fill(begin: int, out: Gaussians) -> None:
                end, done = begin + len(out), begin
                while done < end:
                    index = int(np.searchsorted(ends, done, side="right"))
                    first = int(ends[index]) - sections[index].num_rows
                    stop = min(end, int(ends[index]))
                    sections[index].fill(file, done - first, out.rows(done - begin, stop - begin))
                    done = stop

            yield fill

    return FileRows(str(path), int(ends[-1]) if len(ends) else 0, found.degree, start)


def _parse(path: Path, file: BinaryIO) -> _File:
    num_bytes = path.stat().st_size
    data = file.read(_HEADER_BYTES)
    if len(data) < _HEADER_BYTES:
        raise FormatError(f"{path}: found {len(data)} bytes, wanted a header of {_HEADER_BYTES}; the file is cut off")
    header = np.frombuffer(data, _HEADER)[0]
    level, num_sections = int(header["level"]), int(header["max_sections"])
    if header["major"] != 0 or header["minor"] != 1:
        raise FormatError(f"{path}: found version {header['major']}.{header['minor']}, wanted 0.1")
    if level > 2:
        raise FormatError(f"{path}: found compression level {level}, wanted 0, 1 or 2")
    if _HEADER_BYTES + num_sections * _SECTION_BYTES > num_bytes:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted more for {num_sections} section headers; it is cut off"
        )
    sections = np.frombuffer(file.read(num_sections * _SECTION_BYTES), _SECTION)
    starts, end = [], _HEADER_BYTES + num_sections * _SECTION_BYTES
    for number, section in enumerate(sections):
        _check_section(section, level, f"{path}: section {number}")
        starts.append(end)
        record = _record(level, int(section["degree"]))
        end += 4 * int(section["partial_buckets"]) + int(section["bucket_bytes"]) * int(section["buckets"])
        end += record.itemsize * int(section["max_rows"])
    if end != num_bytes:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted {end} for its {num_sections} sections; it is cut off or damaged"
        )
    low, high = (float(end) or default for end, default in zip(header["rest_range"], _REST_RANGE, strict=True))
    if not -_HALF_MAX <= low < high <= _HALF_MAX:
        raise FormatError(f"{path}: found harmonics between {low} and {high}, wanted a range of finite numbers")
    return _File(level, (low, high), sections, starts)


def _check_section(section: np.void, level: int, where: str) -> None:
    if section["degree"] > 3:
        raise FormatError(f"{where}: found harmonics of degree {section['degree']}, wanted 0 to 3")
    if section["rows"] > section["max_rows"]:
        raise FormatError(
            f"{where}: found {section['rows']} splats, wanted at most the {section['max_rows']} it has room for"
        )
    if level == 0:
        return
    if section["bucket_bytes"] != 12:
        raise FormatError(f"{where}: found {section['bucket_bytes']} bytes a bucket, wanted 12")
    if not 0 < section["block_size"] < np.inf:
        raise FormatError(f"{where}: found a block size of {section['block_size']}, wanted more than 0, finite")
    if int(section["full_buckets"]) + int(section["partial_buckets"]) != section["buckets"]:
        raise FormatError(
            f"{where}: found {section['buckets']} buckets, wanted the {section['full_buckets']} full and "
            f"{section['partial_buckets']} partial ones it counts"
        )


class _Section:
    """Where the records of a section are, and what their codes stand for."""

    def __init__(self, file: BinaryIO, found: _File, section: np.void, start: int, where: str) -> None:
        self.num_rows = int(section["rows"])
        self._where, self._level, degree = where, found.level, int(section["degree"])
        self._record, self._rest_places = _record(found.level, degree), 3 + _rest_order(degree)
        file.seek(start)
        lengths = np.fromfile(file, "<u4", int(section["partial_buckets"]))
        bucket_bytes = int(section["bucket_bytes"]) * int(section["buckets"])
        self._start = start + lengths.nbytes + bucket_bytes
        if found.level > 0:
            self._centres = np.fromfile(file, "<f4", bucket_bytes // 4).reshape(-1, 3)
            full = np.full(int(section["full_buckets"]), int(section["bucket_rows"]), np.int64)
            self._bucket_ends = np.cumsum(np.concatenate([full, lengths.astype(np.int64)]))
            ends = self._bucket_ends
            if self.num_rows > (ends[-1] if len(ends) else 0):
                raise FormatError(f"{where}: found buckets of {ends[-1:].sum()} splats in all, wanted {self.num_rows}")
            self._code_range = int(section["code_range"]) or _CODE_RANGE
            self._step = float(section["block_size"]) / 2 / self._code_range
        low, high = found.rest_range
        self._rest_table = (low + (high - low) * _SHARE).astype(np.float32)

    def fill(self, file: BinaryIO, first: int, out: Gaussians) -> None:
        """Decode the rows from ``first`` on."""
        file.seek(self._start + first * self._record.itemsize)
        records = np.fromfile(file, self._record, len(out))
        if len(records) < len(out):
            raise FormatError(f"{self._where}: cannot be read to its end; did the file change meanwhile?")
        if self._level > 0:
            bucket = np.searchsorted(self._bucket_ends, np.arange(first, first + len(out)), side="right")
            means = (records["mean"].astype(np.float64) - self._code_range) * self._step + self._centres[bucket]
            out.means[:] = means
            scale = np.maximum(records["scale"].astype(np.float32), np.float32(_HALF_MIN / 2))
        else:
            out.means[:], scale = records["mean"], records["scale"]
        with np.errstate(divide="ignore", invalid="ignore"):  # what has no logarithm is found by the check of values
            np.log(scale, out=out.log_scales)
        out.quats[:] = records["quat"]
        out.logit_opacities[:] = _LOGITS[records["rgba"][:, 3]]
        out.sh[:, 0] = _COLORS[records["rgba"][:, :3]]
        sh = out.sh.reshape(len(out), -1)
        sh[:, 3 + len(self._rest_places) :] = 0  # of a degree that other sections have
        sh[:, self._rest_places] = self._rest_table[records["rest"]] if self._level == 2 else records["rest"]


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write one section at level 0, 1 (the default) or 2, in blocks that follow each other along the axes.

    Colours are clipped to 0 to 1 (and counted) and scales to what half precision holds; no row is dropped. Means and the records
    of the file, 24 to 72 bytes a row at levels 1 and 2, are kept in memory.
    """
    level = 1 if options.compression is None else options.compression
    if level not in (0, 1, 2):
        raise InputError(f"{path.name}: found compression {level}, wanted level 0, 1 or 2")
    n, degree = len(chunks), min(chunks.sh_degree, 2)
    seen = _look(chunks, degree)
    record, order = _record(level, degree), _rest_order(degree)
    buckets = _buckets(seen.means, seen.median_sigma) if level > 0 else _NO_BUCKETS
    rest_step = max(seen.rest_range[1] / 127, -seen.rest_range[0] / 128) or 1.5 / 128

    header, section = np.zeros(1, _HEADER), np.zeros(1, _SECTION)
    header["minor"], header["level"] = 1, level
    header["max_sections"] = header["sections"] = 1
    header["max_rows"] = header["rows"] = n
    header["centre"] = seen.means.mean(axis=0, dtype=np.float64) if n else 0
    header["rest_range"] = (-128 * rest_step, 127 * rest_step) if level == 2 else 0
    section["rows"] = section["max_rows"] = n
    section["degree"] = degree
    if level > 0:
        section["bucket_rows"], section["bucket_bytes"], section["code_range"] = _BUCKET_ROWS, 12, _CODE_RANGE
        section["buckets"], section["block_size"] = len(buckets.centres), buckets.block_size
        section["full_buckets"], section["partial_buckets"] = buckets.num_full, len(buckets.partial_lengths)
    section["bytes"] = min(2**32 - 1, n * record.itemsize + buckets.partial_lengths.nbytes + 12 * len(buckets.centres))
    step = float(section["block_size"][0]) / 2 / _CODE_RANGE
    places = np.empty(n, np.int32)
    if level > 0:
        places[buckets.rows] = np.arange(n, dtype=np.int32)
    del seen
    num_clipped = begin = 0
    in_place = np.empty((n if level > 0 else 0, record.itemsize), np.uint8)
    with path.open("wb") as file, task(f"write {path.name}", n) as advance:
        for part in (header, section, buckets.partial_lengths, buckets.centres.astype("<f4")):
            file.write(part.data)
        for g in chunks:
            records, rows = np.empty(len(g), record), slice(begin, begin + len(g))
            means, scale = g.means, np.exp(g.log_scales)
            if level > 0:
                centre = buckets.centres[buckets.bucket_from_place[places[rows]]]
                codes = np.rint((means - centre.astype(np.float64)) / step) + _CODE_RANGE
                means, scale = np.clip(codes, 0, 2 * _CODE_RANGE + 1), np.clip(scale, _HALF_MIN, _HALF_MAX)
            records["mean"], records["scale"] = means, scale
            quats = g.quats.astype(np.float64)
            records["quat"] = quats / np.linalg.norm(quats, axis=1, keepdims=True)
            color = 0.5 + SH_C0 * g.sh[:, 0].astype(np.float64)
            num_clipped += int(((color < -_CLIP_MIN) | (color > 1 + _CLIP_MIN)).any(axis=1).sum())
            records["rgba"][:, :3] = np.rint(np.clip(color, 0, 1) * 255)
            records["rgba"][:, 3] = np.rint(opacities_from_logits(g.logit_opacities) * np.float32(255))
            rest = g.sh.reshape(len(g), -1)[:, 3 + order]
            if level == 1:
                rest = np.clip(rest, -_HALF_MAX, _HALF_MAX)
            if level == 2:
                rest = np.clip(np.rint(rest / rest_step) + 128, 0, 255)
            records["rest"] = rest
            if level > 0:
                in_place[places[rows]] = records.view(np.uint8).reshape(len(g), -1)
            else:
                file.write(records.data)
            begin += len(g)
            advance(len(g))
        file.write(in_place.data)
    return (f"the colours of {num_clipped:,} Gaussians: ksplat clips them to 0 to 1",) if num_clipped else ()


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a first pass over all rows finds."""

    means: Array  # [n 3]
    median_sigma: float  # of the middle standard deviation
    rest_range: tuple[float, float]  # of the harmonics that are written, 0 among them


def _look(chunks: Chunks, degree: int) -> _Seen:
    means, begin, every = np.empty((len(chunks), 3), np.float32), 0, len(chunks) // _SAMPLE + 1
    sample, low, high = [np.zeros(0, np.float32)], 0.0, 0.0
    for g in chunks:
        refuse_unusable(g, "scene to write", first_row=begin)
        means[begin : begin + len(g)] = g.means
        sample.append(np.sort(g.log_scales[-begin % every :: every], axis=1)[:, 1])
        rest = g.sh[:, 1 : (degree + 1) ** 2]
        low, high = min(low, float(rest.min(initial=0))), max(high, float(rest.max(initial=0)))
        begin += len(g)
    middle = np.concatenate(sample)
    return _Seen(means, float(np.exp(np.median(middle))) if len(middle) else 1.0, (low, high))


@dataclass(frozen=True, eq=False)
class _Buckets:
    """Rows gathered in cubes, up to 256 in a bucket: full buckets first, then the last one of each cube."""

    rows: Array  # [n] row at each place of the file
    bucket_from_place: Array  # [n]
    centres: Array  # [b 3] float32
    num_full: int
    partial_lengths: Array  # [partial] <u4
    block_size: float


_NO_BUCKETS = _Buckets(*2 * (np.zeros(0, np.intp),), np.zeros((0, 3), np.float32), 0, np.zeros(0, "<u4"), 0.0)


def _buckets(means: Array, median_sigma: float) -> _Buckets:
    n = len(means)
    block_size = float(np.float32(min(_BLOCK_SIZE, _BLOCK_SIZE_IN_SIGMAS * median_sigma)))
    low = means.min(axis=0, initial=np.inf).astype(np.float64)
    order, key = _by_block(means, low, block_size)
    is_first = np.ones(n, bool)
    is_first[1:] = key[1:] != key[:-1]
    del key
    start = np.flatnonzero(is_first)
    sizes = np.diff(start, append=n)
    place = np.arange(n, dtype=np.int32) - np.repeat(start.astype(np.int32), sizes)  # in its block
    is_partial = place >= np.repeat(sizes // _BUCKET_ROWS * _BUCKET_ROWS, sizes)
    is_start = place % _BUCKET_ROWS == 0
    by_fullness = np.argsort(is_partial, kind="stable").astype(np.int32)
    is_start, order = is_start[by_fullness], order[by_fullness]
    del by_fullness, is_partial, place
    blocks = np.floor((means[order[is_start]] - low) / block_size)
    centres = (low + (blocks + 0.5) * block_size).astype(np.float32)
    partial_lengths = (sizes % _BUCKET_ROWS).astype("<u4")
    return _Buckets(
        order,
        np.cumsum(is_start, dtype=np.int32) - np.int32(1),
        centres,
        int((sizes // _BUCKET_ROWS).sum()),
        partial_lengths[partial_lengths > 0],
        block_size,
    )


def _by_block(means: Array, low: Array, block_size: float) -> tuple[Array, Array]:
    """Rows in the order of their blocks, along x first, and a number for the block of each of these."""
    counts = np.floor((means.max(axis=0, initial=-np.inf) - low) / block_size) + 1 if len(means) else np.ones(3)
    if float(counts.prod()) < 2**62:
        key = np.zeros(len(means), np.int64)
        for axis in (2, 1, 0):
            key *= int(counts[axis])
            key += np.floor((means[:, axis] - low[axis]) / block_size).astype(np.int64)
    else:  # astronomically far outliers
        blocks = np.floor((means - low) / block_size)[:, ::-1]
        key = np.unique(blocks, axis=0, return_inverse=True)[1].astype(np.int64)
    order = np.argsort(key, kind="stable").astype(np.int32)
    return order, key[order]
