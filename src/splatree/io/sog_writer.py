"""Writes SOG version 2, as a ``.sog`` bundle or as a folder of pictures with ``meta.json``.

Rows go along a Morton curve, so that neighbouring pixels are neighbours in space. Scales and DC colours get a codebook each
(`splatree.io.codebook`), harmonics a palette (`splatree.io.palette`) whose values get a codebook of their own. What was read
from a SOG has few different values, which the codebooks hold exactly: it is written without further loss but for the quanta
of the means, whose ranges may differ.

Pictures are written at the WebP method that packs a million Gaussians within 1 % of the smallest size in a CPU-second
(benchmarks/sog.py), on all processors.
"""

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.check import checked
from splatree.io.codebook import Codebook, find_codebook
from splatree.io.options import WriteOptions
from splatree.io.palette import find_palette
from splatree.io.replacing import replacing
from splatree.kernels.cpu import _core
from splatree.kernels.cpu import sog as kernel
from splatree.maths.morton import morton_codes
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Mode, Scene
from splatree.shapes import Array, Float32

_SIDE_MAX = 16380
"""Largest width and height of a WebP picture that is a multiple of four, px."""

_PALETTE_MAX = 1 << 16
_ENTRIES_PER_ROW = 64
_LOGIT_MAX = 30.0
_WEIGHT_MIN = 1e-6
"""Of the mean weight: rows that no picture shows still have some place in the palette."""

_ROUNDS, _ROUNDS_MAX = 3, 1000
_WEBP_METHOD, _WEBP_QUALITY = 1, 0


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write a bundle."""
    checked(scene, "scene to write", repair=False)
    pictures, meta = encode(scene.gaussians, scene.mode, options)
    import zipfile

    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as bundle:
        for name, data in {"meta.json": json.dumps(meta).encode(), **pictures}.items():
            bundle.writestr(zipfile.ZipInfo(name), data)  # with a fixed date: equal scenes give equal files
    return ()


def write_folder(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write meta.json, and its pictures beside it.

    Pictures are named by a digest of the scene and meta.json comes last, so that an older scene in the folder is whole until it
    is replaced. Its pictures stay.
    """
    checked(scene, "scene to write", repair=False)
    pictures, meta = encode(scene.gaussians, scene.mode, options)
    import hashlib

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
        path.write_text(json.dumps(meta))
    except BaseException:  # a full disk, an interruption: no meta.json will name these
        for target in new:
            target.unlink(missing_ok=True)
        raise
    return ()


def encode(g: Gaussians, mode: Mode, options: WriteOptions) -> tuple[dict[str, bytes], dict[str, Any]]:
    """The pictures by name, and the contents of meta.json."""
    n = len(g)
    if n > _SIDE_MAX**2:
        raise InputError(f"SOG: found {n} Gaussians, wanted at most {_SIDE_MAX**2}; write the scene in chunks")
    with task("encode SOG", 3.0) as advance:
        weights = _weights(g)
        palette = None
        if g.sh_degree > 0 and n:
            palette = find_palette(g.sh, weights, _palette_size(n, options), iterations=_iterations(options))
        advance(1.0)
        order = np.argsort(morton_codes(g.means), kind="stable").astype(np.int32)
        mean_ranges = _mean_ranges(g.means)
        scales, dc = find_codebook(g.log_scales, weights), find_codebook(g.sh[:, 0], weights)
        pixels = kernel.encode(g, order, mean_ranges, scales.bounds, dc.bounds)
        width = 4 * math.ceil(math.sqrt(n) / 4) or 4
        images = {name: _picture(codes, width) for name, codes in pixels.items()}
        meta: dict[str, Any] = {
            "version": 2,
            "asset": {"generator": "splatree"},
            "count": n,
            "model": "antialiased" if mode == "antialiased" else "default",
            "means": {
                "mins": mean_ranges[0].tolist(),
                "maxs": mean_ranges[1].tolist(),
                "files": ["means_l.webp", "means_u.webp"],
            },
            "scales": {"codebook": _listed(scales), "files": ["scales.webp"]},
            "quats": {"files": ["quats.webp"]},
            "sh0": {"codebook": _listed(dc), "files": ["sh0.webp"]},
        }
        if palette is not None:
            rest = find_codebook(palette.entries)
            images["shN_centroids"] = _centroids(kernel.find_codes(palette.entries, rest.bounds))
            labels = palette.labels[order]
            images["shN_labels"] = _picture(
                np.stack([labels & 255, labels >> 8, 0 * labels], 1).astype(np.uint8), width
            )
            meta["shN"] = {
                "count": len(palette.entries),
                "bands": g.sh_degree,
                "codebook": _listed(rest),
                "files": ["shN_centroids.webp", "shN_labels.webp"],
            }
        advance(1.0)
        pictures = _webp(images)
        advance(1.0)
    return pictures, meta


def _weights(g: Gaussians) -> Float32[Array, "n"]:
    """What a picture sees of each row: opacity × area; the largest hundredth counts as the one below it."""
    if not len(g):
        return np.zeros(0, np.float32)
    middle, high = np.sort(g.log_scales, axis=1).T[1:]
    area = np.exp(middle + high)
    weights = np.minimum(area, np.quantile(area, 0.99)) / (1 + np.exp(-np.maximum(g.logit_opacities, -_LOGIT_MAX)))
    return np.asarray(weights / weights.mean() + _WEIGHT_MIN, np.float32)


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


def _mean_ranges(means: Array) -> Array:
    if not len(means):
        return np.zeros((2, 3))
    ends = np.array([[f(x) for x in means.T] for f in (np.min, np.max)], np.float64)
    return np.asarray(np.sign(ends) * np.log1p(np.abs(ends)))


def _listed(codebook: Codebook) -> list[float]:
    return [float(v) for v in codebook.values]


def _picture(codes: Array, width: int) -> Array:
    """Codes "n c" as a picture, row by row, filled up with zeros; its height is a multiple of four as its width is."""
    n, channels = codes.shape
    height = 4 * math.ceil(n / width / 4) or 4
    picture = np.zeros((height * width, channels), np.uint8)
    picture[:n] = codes
    return picture.reshape(height, width, channels)


def _centroids(codes: Array) -> Array:
    """Codes "p j 3" as a picture of 64 entries a row."""
    count, per_channel, _ = codes.shape
    height = -(-count // _ENTRIES_PER_ROW)
    picture = np.zeros((height * _ENTRIES_PER_ROW, per_channel, 3), np.uint8)
    picture[:count] = codes
    return picture.reshape(height, _ENTRIES_PER_ROW * per_channel, 3)


def _webp(images: dict[str, Array]) -> dict[str, bytes]:
    from concurrent.futures import ThreadPoolExecutor

    from PIL import Image

    def packed(image: Array) -> bytes:
        buffer = io.BytesIO()
        options: dict[str, Any] = {"lossless": True, "exact": True, "method": _WEBP_METHOD, "quality": _WEBP_QUALITY}
        Image.fromarray(image).save(buffer, "WEBP", **options)
        return buffer.getvalue()

    with ThreadPoolExecutor(_core.hardware_threads()) as pool:
        return {f"{name}.webp": data for name, data in zip(images, pool.map(packed, images.values()), strict=True)}
