"""A small writer of SOG folders, for tests alone: what it encodes is known exactly."""

import json
import math
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image


def webp(path: Path, pixels: np.ndarray, width: int) -> None:
    """Write "n c" bytes as a lossless picture, row by row, padded with zeros."""
    n, channels = pixels.shape
    height = max(1, math.ceil(n / width))
    padded = np.zeros((height * width, channels), np.uint8)
    padded[:n] = pixels
    Image.fromarray(padded.reshape(height, width, channels)).save(path, lossless=True, exact=True)


def write_sog(folder: Path, *, n: int = 21, version: int = 2, bands: int = 1, palette: int = 70, seed: int = 0) -> dict:
    """Write a folder of random codes; return them, with the meta.json."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    codes = {
        "means_l": rng.integers(0, 256, (n, 3)),
        "means_u": rng.integers(0, 256, (n, 3)),
        "scales": rng.integers(0, 256, (n, 3)),
        "quats": np.column_stack([rng.integers(60, 196, (n, 3)), 252 + rng.integers(0, 4, n)]),
        "sh0": rng.integers(0, 256, (n, 4)),
    }
    width = 4 * math.ceil(math.sqrt(n) / 4) if n else 4
    meta: dict = {
        "means": {"mins": [-1.0, -2.0, 0.5], "maxs": [1.5, 2.0, 3.0], "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"files": ["sh0.webp"]},
    }
    if version == 2:
        meta |= {"version": 2, "count": n}
        meta["scales"]["codebook"] = np.linspace(-9, 1, 256).tolist()
        meta["sh0"]["codebook"] = np.linspace(-2, 2, 256).tolist()
    else:
        meta["means"]["shape"] = [n, 3]
        meta["scales"] |= {"mins": [-9.0, -8.0, -7.0], "maxs": [1.0, 0.0, -1.0]}
        meta["sh0"] |= {"mins": [-2.0, -1.0, -2.0, -5.0], "maxs": [2.0, 1.0, 3.0, 5.0]}
    if bands:
        per_channel = {1: 3, 2: 8, 3: 15}[bands]
        codes["labels"] = rng.integers(0, palette, n)
        codes["centroids"] = rng.integers(0, 256, (palette, per_channel, 3))
        meta["shN"] = {"files": ["centroids.webp", "labels.webp"]}
        if version == 2:
            meta["shN"] |= {"count": palette, "bands": bands, "codebook": np.linspace(-1, 1, 256).tolist()}
        else:
            meta["shN"] |= {"mins": -1.0, "maxs": 1.0}
        labels = np.column_stack([codes["labels"] & 255, codes["labels"] >> 8, np.zeros(n)]).astype(np.uint8)
        webp(folder / "labels.webp", labels, width)
        rows = np.zeros((math.ceil(palette / 64) * 64, per_channel, 3), np.uint8)
        rows[:palette] = codes["centroids"]
        webp(folder / "centroids.webp", rows.reshape(-1, 3), 64 * per_channel)
    for name in ("means_l", "means_u", "scales", "quats", "sh0"):
        webp(folder / f"{name}.webp", codes[name].astype(np.uint8), width)
    (folder / "meta.json").write_text(json.dumps(meta))
    return {**codes, "meta": meta}


def bundle(folder: Path, path: Path, *, compression: int = zipfile.ZIP_STORED) -> None:
    """Pack a folder as a .sog bundle."""
    with zipfile.ZipFile(path, "w", compression) as out:
        for file in sorted(folder.iterdir()):
            out.write(file, file.name)
