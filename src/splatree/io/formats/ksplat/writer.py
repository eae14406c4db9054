"""Writing a ``.ksplat``: one section, at levels 1 and 2 in cubes of space; `ksplat/format.py` describes the file."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.colors import num_clipped
from splatree.io.formats.ksplat.layout import CODE_RANGE, HALF_MAX, HALF_MIN, HEADER, SECTION, record_of, rest_order
from splatree.io.memory import Scratch
from splatree.io.notes import gaussians_in_words
from splatree.io.opacities import opacities_from_logits
from splatree.io.options import WriteOptions
from splatree.io.sorting import Sorter
from splatree.kernels.cpu.runtime.files import write_at
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array

_BUCKET_ROWS = 256
_BLOCK_SIZE = 5.0
"""Side of a block, world units, that the format's tools write; ours is smaller in scenes of small Gaussians …"""

_BLOCK_SIZE_IN_SIGMAS = 1310.0
"""… at most this many times the median standard deviation, so that a step is at most 2 % of it."""

_SAMPLE = 1 << 16
"""Rows, evenly spread, of which the median is taken."""


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write one section at level 0, 1 (the default) or 2, in blocks that follow each other along the axes.

    Colours are clipped to 0 to 1, and scales and harmonics to what half precision holds, and counted; no row is dropped. Records
    are sorted by their blocks, through files where memory has no room for them.
    """
    level = 1 if options.compression is None else options.compression
    if level not in (0, 1, 2):
        raise InputError(f"{path.name}: found compression {level}, wanted level 0, 1 or 2")
    seen = _look(chunks, min(chunks.sh_degree, 2))
    codes = _Codes(level, min(chunks.sh_degree, 2), seen.rest_range)
    with path.open("wb", buffering=0) as file, task(f"write {path.name}", len(chunks)) as advance:
        if level > 0:
            _write_blocks(chunks, file, seen, codes, Scratch.beside(path, options.max_memory), advance)
        else:
            at = _write_next(file, 0, *_heads(len(chunks), seen, codes, None))
            for g in chunks:
                at = _write_next(file, at, codes.records(g, g.means, np.exp(g.log_scales)))
                advance(len(g))
    counts = {
        "colours": (codes.num_clipped, "ksplat clips them to 0 to 1"),
        "standard deviations": (codes.num_scales_clamped, f"ksplat clamps them to {HALF_MIN:.2g} to {HALF_MAX:g}"),
        "harmonics": (codes.num_rest_clamped, f"ksplat clamps them to ±{HALF_MAX:g}"),
    }
    return tuple(f"the {what} of {gaussians_in_words(n)}: {how}" for what, (n, how) in counts.items() if n)


def _write_next(file: BinaryIO, at: int, *parts: Array) -> int:
    """Write arrays one after the other; return where the last one ends."""
    for part in parts:
        write_at(file, at, part)
        at += part.nbytes
    return at


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a first pass over all rows finds."""

    low: Array  # [3] float64, least means
    high: Array  # [3]
    centre: Array  # [3] float64, mean of the means
    median_sigma: float  # of the middle standard deviation
    rest_range: tuple[float, float]  # of the harmonics that are written, 0 among them
    sample: Array  # [s 3] some of the means


def _look(chunks: Chunks, degree: int) -> _Seen:
    begin, every = 0, len(chunks) // _SAMPLE + 1
    sample, means, low, high = [np.zeros(0, np.float32)], [np.zeros((0, 3), np.float32)], 0.0, 0.0
    sums, ends = np.zeros(3), np.array([[np.inf] * 3, [-np.inf] * 3])
    for g in chunks:
        refuse_unusable(g, "scene to write", first_row=begin)
        sums += g.means.sum(axis=0, dtype=np.float64)
        ends = np.stack([np.minimum(ends[0], g.means.min(axis=0)), np.maximum(ends[1], g.means.max(axis=0))])
        sample.append(np.sort(g.log_scales[-begin % every :: every], axis=1)[:, 1])
        means.append(g.means[-begin % every :: every].copy())
        rest = g.sh[:, 1 : (degree + 1) ** 2]
        low, high = min(low, float(rest.min(initial=0))), max(high, float(rest.max(initial=0)))
        begin += len(g)
    middle = np.concatenate(sample)
    sigma = float(np.exp(np.median(middle))) if len(middle) else 1.0
    return _Seen(ends[0], ends[1], sums / max(1, begin), sigma, (low, high), np.concatenate(means))


class _Codes:
    """How values become those of a record."""

    def __init__(self, level: int, degree: int, rest_range: tuple[float, float]) -> None:
        self.level, self.degree = level, degree
        self.record, self._order = record_of(level, degree), rest_order(degree)
        self.rest_step = min(HALF_MAX / 128, max(rest_range[1] / 127, -rest_range[0] / 128)) or 1.5 / 128
        self.num_clipped = self.num_scales_clamped = self.num_rest_clamped = 0

    def records(self, g: Gaussians, means: Array, scale: Array) -> Array:
        """Records of Gaussians, whose means and scales are given as they are stored."""
        records = np.empty(len(g), self.record)
        if self.level > 0:
            held = np.clip(scale, HALF_MIN, HALF_MAX)
            self.num_scales_clamped += int((held != scale).any(axis=1).sum())
            scale = held
        records["mean"], records["scale"] = means, scale
        quats = g.quats.astype(np.float64)
        records["quat"] = quats / np.linalg.norm(quats, axis=1, keepdims=True)
        color = 0.5 + SH_C0 * g.sh[:, 0].astype(np.float64)
        self.num_clipped += num_clipped(g.sh[:, 0])
        records["rgba"][:, :3] = np.rint(np.clip(color, 0, 1) * 255)
        records["rgba"][:, 3] = np.rint(opacities_from_logits(g.logit_opacities) * np.float32(255))
        rest = g.sh.reshape(len(g), -1)[:, 3 + self._order]
        if self.level == 2:
            rest = np.rint(rest / self.rest_step) + 128
        if self.level > 0:
            held = np.clip(rest, *((-HALF_MAX, HALF_MAX) if self.level == 1 else (0, 255)))
            self.num_rest_clamped += int((held != rest).any(axis=1).sum())
            rest = held
        records["rest"] = rest
        return records


def _write_blocks(
    chunks: Chunks, file: BinaryIO, seen: _Seen, codes: _Codes, scratch: Scratch, advance: Callable[[float], None]
) -> None:
    """Rows in cubes of space, up to 256 in a bucket: full buckets first, then the last one of each cube."""
    n, blocks = len(chunks), _Blocks.of(chunks, seen)
    step = float(np.float32(blocks.size)) / 2 / CODE_RANGE
    with Sorter(n, codes.record.itemsize, blocks.keys(seen.sample), scratch) as sorter:
        for g in chunks:
            keys = blocks.keys(g.means)
            apart = g.means - blocks.centres(keys).astype(np.float64)
            means = np.clip(np.rint(apart / step) + CODE_RANGE, 0, 2 * CODE_RANGE + 1)
            records = codes.records(g, means, np.exp(g.log_scales))
            sorter.put(keys, records.view(np.uint8).reshape(len(g), -1))
            advance(len(g) / 2)
        keys, sizes = _run_lengths(found for found, _ in sorter.runs())
        full, partial = sizes // _BUCKET_ROWS, sizes % _BUCKET_ROWS
        of_bucket = np.concatenate([np.repeat(keys, full), keys[partial > 0]])
        buckets = _Buckets(blocks.size, int(full.sum()), partial[partial > 0].astype("<u4"), blocks.centres(of_bucket))
        at = _write_next(file, 0, *_heads(n, seen, codes, buckets))
        places = [at, at + buckets.num_full * _BUCKET_ROWS * codes.record.itemsize]  # of full buckets, and of others
        start, done = np.cumsum(sizes) - sizes, 0
        for found, rows in sorter.runs():
            block = np.searchsorted(keys, found)
            is_partial = np.arange(done, done + len(found)) - start[block] >= full[block] * _BUCKET_ROWS
            for kind in (0, 1):
                places[kind] = _write_next(file, places[kind], rows[is_partial == kind])
            done += len(found)
            advance(len(found) / 2)


def _run_lengths(runs: Iterable[Array]) -> tuple[Array, Array]:
    """The different keys of sorted runs, and how often each is there."""
    keys, sizes = [np.empty(0, np.uint64)], [np.empty(0, np.int64)]
    for run in runs:
        own, counts = np.unique(run, return_counts=True)
        if len(keys[-1]) and keys[-1][-1] == own[0]:  # it goes on
            sizes[-1][-1] += counts[0]
            own, counts = own[1:], counts[1:]
        if len(own):
            keys.append(own)
            sizes.append(counts)
    return np.concatenate(keys), np.concatenate(sizes)


@dataclass(frozen=True, eq=False)
class _Buckets:
    """What a section says of its buckets."""

    block_size: float
    num_full: int
    partial_lengths: Array  # [partial] <u4
    centres: Array  # [b 3] float32


def _heads(n: int, seen: _Seen, codes: _Codes, buckets: _Buckets | None) -> list[Array]:
    """All of the file before its records."""
    header, section = np.zeros(1, HEADER), np.zeros(1, SECTION)
    header["minor"], header["level"] = 1, codes.level
    header["max_sections"] = header["sections"] = 1
    header["max_rows"] = header["rows"] = n
    header["centre"] = seen.centre
    header["rest_range"] = (-128 * codes.rest_step, 127 * codes.rest_step) if codes.level == 2 else 0
    section["rows"] = section["max_rows"] = n
    section["degree"] = codes.degree
    tables: list[Array] = []
    if buckets is not None:
        tables = [buckets.partial_lengths, buckets.centres.astype("<f4")]
        section["bucket_rows"], section["bucket_bytes"], section["code_range"] = _BUCKET_ROWS, 12, CODE_RANGE
        section["buckets"], section["block_size"] = len(buckets.centres), buckets.block_size
        section["full_buckets"], section["partial_buckets"] = buckets.num_full, len(buckets.partial_lengths)
    section["bytes"] = min(2**32 - 1, n * codes.record.itemsize + sum(table.nbytes for table in tables))
    return [header, section, *tables]


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Cubes of space, numbered along x first."""

    low: Array  # [3] float64, the least corner
    size: float
    counts: tuple[int, int, int]
    known: Array | None  # [b 3] those with rows, z y x, where there are too many to number all

    @staticmethod
    def of(chunks: Chunks, seen: _Seen) -> "_Blocks":
        size = float(np.float32(min(_BLOCK_SIZE, _BLOCK_SIZE_IN_SIGMAS * seen.median_sigma)))
        low = seen.low
        counts = np.floor((seen.high - low) / size) + 1 if len(chunks) else np.ones(3)
        known = None
        if float(counts.prod()) >= 2**62:  # astronomically far outliers
            parts = [np.empty((0, 3))]
            parts += [np.unique(np.floor((g.means - low) / size)[:, ::-1], axis=0) for g in chunks]
            known, counts = np.unique(np.concatenate(parts), axis=0), np.ones(3)
        return _Blocks(low, size, (int(counts[0]), int(counts[1]), int(counts[2])), known)

    def keys(self, means: Array) -> Array:
        """The number of the block of each mean."""
        blocks = np.floor((means - self.low) / self.size)
        if self.known is not None:
            return np.searchsorted(_as_records(self.known), _as_records(blocks[:, ::-1])).astype(np.uint64)
        keys = np.zeros(len(means), np.uint64)
        for axis in (2, 1, 0):
            keys *= np.uint64(self.counts[axis])
            keys += blocks[:, axis].astype(np.uint64)
        return keys

    def centres(self, keys: Array) -> Array:
        """The middle of each block, as the file stores it."""
        if self.known is not None:
            blocks = self.known[keys.astype(np.intp), ::-1]
        else:
            x, y, _ = (np.uint64(count) for count in self.counts)
            blocks = np.stack([keys % x, keys // x % y, keys // (x * y)], axis=1).astype(np.float64)
        return (self.low + (blocks + 0.5) * self.size).astype(np.float32)


def _as_records(blocks: Array) -> Array:
    """Rows that compare as a whole."""
    return np.ascontiguousarray(blocks).view([(axis, np.float64) for axis in "zyx"]).reshape(-1)
