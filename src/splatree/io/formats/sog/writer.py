"""Writes SOG version 2, as a ``.sog`` bundle or as a folder of pictures with ``meta.json``.

Rows go along a Morton curve, so that neighbouring pixels are neighbours in space, or keep their order where the caller has put
them in one that ranges of rows refer to. Scales and DC colours get a codebook each
(`sog/codebook.py`), harmonics a palette (`sog/palette.py`) whose values get a codebook of their own. What was read
from a SOG has few different values, which the codebooks hold exactly: it is written without further loss but for the quanta
of the means, whose ranges may differ.

Pictures are written at the WebP method that packs a million Gaussians within 1 % of the smallest size in a CPU-second
(benchmarks/sog.py), on all processors.
"""

import io
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.formats.sog.codebook import CODES, Codebook, find_codebook, sampled_rows
from splatree.io.formats.sog.palette import Palette, find_palette
from splatree.io.memory import Scratch
from splatree.io.options import WriteOptions
from splatree.io.replacing import replacing
from splatree.io.sorting import Sorter
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.codec import sog as kernel
from splatree.maths.morton import frame_of_sample, morton_codes, morton_sample
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64

RowOrder = Literal["morton", "kept"]
"""Which row is which pixel."""

IN_MEMORY = Scratch(math.inf, Path())
"""For what is small: all of it is held in memory."""

_PACKING_BYTES = 37
"""Memory that Pillow and libwebp take for a pixel of a picture while they pack it."""

_WEIGHED = 1 << 20
"""Rows of which the largest hundredth of the weights is found."""

_SIDE_MAX = 16380
"""Largest width and height of a WebP picture that is a multiple of four, px."""

_PALETTE_MAX = 1 << 16
_ENTRIES_PER_ROW = 64
_LOGIT_MAX = 30.0
_WEIGHT_MIN = 1e-6
"""Of the mean weight: rows that no picture shows still have some place in the palette."""

_ROUNDS, _ROUNDS_MAX = 3, 1000
WEBP_METHOD, WEBP_QUALITY = 1, 0
"""How hard libwebp tries: a tenth of its default's time, and hardly larger (docs/reference/formats/sog.md)."""


def write_chunks(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write a bundle."""
    import zipfile

    pictures, meta = encode(chunks, options, scratch=Scratch.beside(path, options.max_memory))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as bundle:
        for name, data in {"meta.json": as_json(meta), **pictures}.items():
            bundle.writestr(zipfile.ZipInfo(name), data)  # with a fixed date: equal scenes give equal files
    return ()


def write_folder(chunks: Chunks, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write meta.json, and its pictures beside it.

    Pictures are named by a digest of the scene and meta.json comes last, so that an older scene in the folder is whole until it
    is replaced. Its pictures stay.
    """
    import hashlib

    pictures, meta = encode(chunks, options, scratch=Scratch.beside(path, options.max_memory))
    digest = hashlib.sha256(b"".join(pictures.values())).hexdigest()[:8]
    for part in meta.values():
        if isinstance(part, dict) and "files" in part:
            part["files"] = [name.replace(".webp", f".{digest}.webp") for name in part["files"]]
    targets = {path.parent / name.replace(".webp", f".{digest}.webp"): data for name, data in pictures.items()}
    new = [target for target in targets if not target.exists()]
    try:
        for target, data in targets.items():
            with replacing(target, force=True) as temporary:
                temporary.write_bytes(data)
        path.write_bytes(as_json(meta))
    except BaseException:  # a full disk, an interruption: no meta.json will name these
        for target in new:
            target.unlink(missing_ok=True)
        raise
    return ()


def encode(
    chunks: Chunks, options: WriteOptions, *, order: RowOrder = "morton", scratch: Scratch = IN_MEMORY
) -> tuple[dict[str, bytes], dict[str, Any]]:
    """The pictures by name, and the contents of meta.json; rows along a Morton curve, or ``kept`` as they come.

    What grows with the scene lies in ``scratch``: 36 bytes a Gaussian, and 28 more while they are put in order. A picture takes
    37 bytes for each pixel while it is packed, in memory.
    """
    n, has_rest = len(chunks), chunks.sh_degree > 0 and len(chunks) > 0
    if n > _SIDE_MAX**2:
        raise InputError(f"SOG: found {n} Gaussians, wanted at most {_SIDE_MAX**2}; write the scene in chunks")
    with task("encode SOG", 3.0) as advance:
        seen = _look(chunks, scratch)
        palette = None
        if has_rest:
            size, rounds = _palette_size(n, options), _iterations(options)
            labels = scratch.zeros((n,), np.int32)
            palette = find_palette(lambda: (g.sh for g in chunks), seen.weights, size, iterations=rounds, labels=labels)
        advance(1.0)
        sample = sampled_rows(n, 3)
        weights = seen.weights[sample]
        scales = find_codebook(seen.log_scales, lambda: _different(chunks, lambda g: g.log_scales), weights)
        dc = find_codebook(seen.dc, lambda: _different(chunks, lambda g: g.sh[:, 0]), weights)
        width = 4 * math.ceil(math.sqrt(n) / 4) or 4
        bounds = (scales.bounds, dc.bounds)
        images = _pictures(chunks, _places(chunks, seen, order, scratch), seen, bounds, palette, width, scratch)
        low, high = seen.mean_ranges.tolist()
        meta: dict[str, Any] = {
            "version": 2,
            "asset": {"generator": "splatree"},
            "count": n,
            "model": "antialiased" if chunks.mode == "antialiased" else "default",
            "means": {"mins": low, "maxs": high, "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"codebook": _listed(scales), "files": ["scales.webp"]},
            "quats": {"files": ["quats.webp"]},
            "sh0": {"codebook": _listed(dc), "files": ["sh0.webp"]},
        }
        if palette is not None:
            entries = palette.entries
            some = entries.reshape(len(entries), -1)
            rest = find_codebook(some[sampled_rows(*some.shape)], lambda: entries)
            images["shN_centroids"] = _centroids(kernel.find_codes(entries, rest.bounds))
            images["shN_labels"] = images.pop("labels")
            meta["shN"] = {
                "count": len(entries),
                "bands": chunks.sh_degree,
                "codebook": _listed(rest),
                "files": ["shN_centroids.webp", "shN_labels.webp"],
            }
        del seen, palette
        advance(1.0)
        pictures = _webp(images, scratch)
        advance(1.0)
    return pictures, meta


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a first pass over all rows finds."""

    means: Float32[Array, "s 3"]
    """Those of `morton_sample`."""
    weights: Float32[Array, "n"]
    """What a picture sees of each row: opacity × area; what is larger than all but a hundredth of a sample counts as that."""
    log_scales: Float32[Array, "s 3"]
    """Those of `sampled_rows`."""
    dc: Float32[Array, "s 3"]
    """Those of `sampled_rows`."""
    mean_ranges: Float64[Array, "2 3"]
    """Least and largest sign(x) ln(1 + |x|) along each axis."""


def _look(chunks: Chunks, scratch: Scratch) -> _Seen:
    n, every, each = len(chunks), sampled_rows(len(chunks), 3).step, morton_sample(len(chunks)).step
    weights, alphas = scratch.zeros((n,), np.float32), scratch.zeros((n,), np.float32)
    means, log_scales, dc = ([np.empty((0, 3), np.float32)] for _ in range(3))
    ends, begin = np.array([[np.inf] * 3, [-np.inf] * 3]) if n else np.zeros((2, 3)), 0
    for g in chunks:
        refuse_unusable(g, "scene to write", first_row=begin)
        rows = slice(begin, begin + len(g))
        ends = np.stack([np.minimum(ends[0], g.means.min(axis=0)), np.maximum(ends[1], g.means.max(axis=0))])
        x, y, z = g.log_scales.T
        weights[rows] = np.exp(x + y + z - np.minimum(np.minimum(x, y), z))  # area of the two larger axes
        alphas[rows] = 1 / (1 + np.exp(-np.maximum(g.logit_opacities, -_LOGIT_MAX)))
        means.append(g.means[-begin % each :: each].copy())
        log_scales.append(g.log_scales[-begin % every :: every].copy())
        dc.append(g.sh[-begin % every :: every, 0].copy())
        begin += len(g)
    if n:
        np.minimum(weights, np.quantile(weights[:: -(-n // _WEIGHED)], 0.99), out=weights)
        weights *= alphas
        weights /= weights.mean()
        weights += np.float32(_WEIGHT_MIN)
    ranges = np.sign(ends) * np.log1p(np.abs(ends))
    return _Seen(np.concatenate(means), weights, np.concatenate(log_scales), np.concatenate(dc), ranges)


def _different(chunks: Chunks, column: Callable[[Gaussians], Array]) -> Array:
    """The different values of a column; some of them if they are more than a codebook has."""
    values = np.empty(0, np.float32)
    for g in chunks:
        values = np.union1d(values, column(g))
        if len(values) > CODES:
            break
    return values


def _places(chunks: Chunks, seen: _Seen, order: RowOrder, scratch: Scratch) -> Array:
    """The pixel of each row."""
    places = scratch.zeros((len(chunks),), np.int32)
    if order == "kept":
        places[:] = np.arange(len(places))
        return places
    frame, begin = frame_of_sample(seen.means), 0
    with Sorter(len(chunks), 4, morton_codes(seen.means, frame), replace(scratch)) as sorter:
        for g in chunks:
            rows = np.arange(begin, begin + len(g), dtype=np.int32)
            sorter.put(morton_codes(g.means, frame), rows.view(np.uint8).reshape(-1, 4))
            begin += len(g)
        begin = 0
        for _, records in sorter.runs():
            rows = np.ascontiguousarray(records).view(np.int32).reshape(-1)
            places[rows] = np.arange(begin, begin + len(rows), dtype=np.int32)
            begin += len(rows)
    return places


def _pictures(
    chunks: Chunks,
    places: Array,
    seen: _Seen,
    bounds: tuple[Array, Array],
    palette: Palette | None,
    width: int,
    scratch: Scratch,
) -> dict[str, Array]:
    """All pictures "h w c" of one pixel a row; their height is a multiple of four as the width is."""
    height = 4 * math.ceil(len(chunks) / width / 4) or 4
    channels = {
        "means_l": 3,
        "means_u": 3,
        "quats": 4,
        "scales": 3,
        "sh0": 4,
        **({} if palette is None else {"labels": 3}),
    }
    pixels = {name: scratch.zeros((height * width, c), np.uint8) for name, c in channels.items()}
    begin = 0
    for g in chunks:
        rows = slice(begin, begin + len(g))
        own = None if palette is None else palette.labels[rows]
        kernel.encode(g, places[rows], seen.mean_ranges, bounds, pixels, labels=own)
        begin += len(g)
    return {name: codes.reshape(height, width, -1) for name, codes in pixels.items()}


def _palette_size(n: int, options: WriteOptions) -> int:
    """Entries of the palette: as other writers choose them by the number of rows, 1024 to 65,536."""
    if options.sh_palette is not None:
        if not 1 <= options.sh_palette <= _PALETTE_MAX:
            raise InputError(f"sh_palette: found {options.sh_palette}, wanted 1 to {_PALETTE_MAX} entries")
        return min(n, options.sh_palette)
    return min(n, _PALETTE_MAX, 1 << max(10, int(math.log2(n))))


def _iterations(options: WriteOptions) -> int:
    if options.iterations is None:
        return _ROUNDS
    if not 0 <= options.iterations <= _ROUNDS_MAX:
        raise InputError(f"iterations: found {options.iterations}, wanted 0 to {_ROUNDS_MAX}")
    return options.iterations


def as_json(meta: dict[str, Any]) -> bytes:
    """The contents of meta.json, without spaces: each unit of a stream has one."""
    return json.dumps(meta, separators=(",", ":")).encode()


def _listed(codebook: Codebook) -> list[float]:
    """The values with as few digits as tell them apart in float32."""
    return [float(str(v)) for v in codebook.values]


def _centroids(codes: Array) -> Array:
    """Codes "p j 3" as a picture of 64 entries a row."""
    count, per_channel, _ = codes.shape
    height = -(-count // _ENTRIES_PER_ROW)
    picture = np.zeros((height * _ENTRIES_PER_ROW, per_channel, 3), np.uint8)
    picture[:count] = codes
    return picture.reshape(height, _ENTRIES_PER_ROW * per_channel, 3)


def _webp(images: dict[str, Array], scratch: Scratch) -> dict[str, bytes]:
    """The pictures packed, as many at the same time as there is room for."""
    from concurrent.futures import ThreadPoolExecutor

    from PIL import Image, WebPImagePlugin

    assert WebPImagePlugin  # loaded, so that saving does not load all formats to find it

    def packed(image: Array) -> bytes:
        buffer = io.BytesIO()
        options: dict[str, Any] = {"lossless": True, "exact": True, "method": WEBP_METHOD, "quality": WEBP_QUALITY}
        Image.fromarray(image).save(buffer, "WEBP", **options)
        return buffer.getvalue()

    largest = max(image.shape[0] * image.shape[1] for image in images.values())
    at_once = max(1, int(min(_core.hardware_threads(), scratch.room / (_PACKING_BYTES * largest))))
    with ThreadPoolExecutor(at_once) as pool:
        return {f"{name}.webp": data for name, data in zip(images, pool.map(packed, images.values()), strict=True)}
