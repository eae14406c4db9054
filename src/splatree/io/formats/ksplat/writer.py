"""Writing a ``.ksplat``: one section, at levels 1 and 2 in cubes of space; `ksplat/format.py` describes the file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.formats.ksplat.layout import CODE_RANGE, HALF_MAX, HALF_MIN, HEADER, SECTION, record_of, rest_order
from splatree.io.opacities import opacities_from_logits
from splatree.io.options import WriteOptions
from splatree.progress import task
from splatree.shapes import Array

_BUCKET_ROWS = 256
_BLOCK_SIZE = 5.0
"""Side of a block, world units, that the format's tools write; ours is smaller in scenes of small Gaussians …"""

_BLOCK_SIZE_IN_SIGMAS = 1310.0
"""… at most this many times the median standard deviation, so that a step is at most 2 % of it."""

_SAMPLE = 1 << 16
"""Rows, evenly spread, of which the median is taken."""

_CLIP_MIN = 0.5 / 255
"""A colour that is clipped by less is only rounded."""


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
    record, order = record_of(level, degree), rest_order(degree)
    buckets = _buckets(seen.means, seen.median_sigma) if level > 0 else _NO_BUCKETS
    rest_step = max(seen.rest_range[1] / 127, -seen.rest_range[0] / 128) or 1.5 / 128

    header, section = np.zeros(1, HEADER), np.zeros(1, SECTION)
    header["minor"], header["level"] = 1, level
    header["max_sections"] = header["sections"] = 1
    header["max_rows"] = header["rows"] = n
    header["centre"] = seen.means.mean(axis=0, dtype=np.float64) if n else 0
    header["rest_range"] = (-128 * rest_step, 127 * rest_step) if level == 2 else 0
    section["rows"] = section["max_rows"] = n
    section["degree"] = degree
    if level > 0:
        section["bucket_rows"], section["bucket_bytes"], section["code_range"] = _BUCKET_ROWS, 12, CODE_RANGE
        section["buckets"], section["block_size"] = len(buckets.centres), buckets.block_size
        section["full_buckets"], section["partial_buckets"] = buckets.num_full, len(buckets.partial_lengths)
    section["bytes"] = min(2**32 - 1, n * record.itemsize + buckets.partial_lengths.nbytes + 12 * len(buckets.centres))
    step = float(section["block_size"][0]) / 2 / CODE_RANGE
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
                codes = np.rint((means - centre.astype(np.float64)) / step) + CODE_RANGE
                means, scale = np.clip(codes, 0, 2 * CODE_RANGE + 1), np.clip(scale, HALF_MIN, HALF_MAX)
            records["mean"], records["scale"] = means, scale
            quats = g.quats.astype(np.float64)
            records["quat"] = quats / np.linalg.norm(quats, axis=1, keepdims=True)
            color = 0.5 + SH_C0 * g.sh[:, 0].astype(np.float64)
            num_clipped += int(((color < -_CLIP_MIN) | (color > 1 + _CLIP_MIN)).any(axis=1).sum())
            records["rgba"][:, :3] = np.rint(np.clip(color, 0, 1) * 255)
            records["rgba"][:, 3] = np.rint(opacities_from_logits(g.logit_opacities) * np.float32(255))
            rest = g.sh.reshape(len(g), -1)[:, 3 + order]
            if level == 1:
                rest = np.clip(rest, -HALF_MAX, HALF_MAX)
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
