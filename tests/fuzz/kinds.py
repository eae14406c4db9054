"""Small files of every kind that the fuzzers and the stored corpus start from: each format in each way in which it is written.

A kind is a format of the registry, or one of its other forms. What is changed of a folder is its JSON file, beside its pictures.
"""

import json
import zipfile
from pathlib import Path

import numpy as np
from tests.io.rad_files import chunk, write_rad
from tests.io.sog_files import bundle, write_sog
from tests.scenes import random_gaussians

import splatree
from splatree import Scene, WriteOptions
from splatree.io.registry import formats

CORPUS = Path(__file__).parent / "corpus"
"""A ZIP of inputs for each kind: those that an earlier run found to reach new branches."""

OTHERS = ("sog-folder-1", "sog-folder-2")
"""Kinds beside the formats of the registry."""


def all_kinds() -> list[str]:
    """Names of all kinds."""
    return [*(f.name for f in formats()), *OTHERS]


def target_of(seeds: list[Path], folder: Path) -> Path:
    """The file whose bytes are changed: that of a folder, or a new one with the suffix of the seeds."""
    return seeds[0] if seeds[0].suffix == ".json" else folder / f"changed{seeds[0].name[seeds[0].name.index('.') :]}"


def stored_inputs(kind: str) -> list[bytes]:
    """The stored inputs of a kind; none if there are none."""
    path = CORPUS / f"{kind}.zip"
    if not path.is_file():
        return []
    with zipfile.ZipFile(path) as stored:
        return [stored.read(name) for name in sorted(stored.namelist())]


def seeds_of(kind: str, folder: Path) -> list[Path]:
    """Small files of a kind; those of a folder format are its meta.json, beside the pictures."""
    if kind in ("sog-folder-1", "sog-folder-2"):
        write_sog(folder / "scene", n=9, version=int(kind[-1]))
        return [folder / "scene" / "meta.json"]
    if kind in ("splatree-folder", "3d-tiles"):
        return [_folder_seed(kind, folder)]
    if kind == "streamed-sog":
        write_sog(folder / "scene" / "0_0", n=9)
        box = {"min": [-1, -1, -1], "max": [1, 1, 1]}
        node = {"bound": box, "lods": {"0": {"file": 0, "offset": 0, "count": 9}}}
        tree = {"bound": box, "children": [node, {**node, "lods": {"0": {"file": 0, "offset": 2, "count": 4}}}]}
        meta = {"version": 1, "count": 13, "counts": [13], "lodLevels": 1, "filenames": ["0_0/meta.json"], "tree": tree}
        (folder / "scene" / "lod-meta.json").write_text(json.dumps(meta))
        return [folder / "scene" / "lod-meta.json"]

    (chosen,) = (f for f in formats() if f.name == kind)
    flat = Scene.flat(random_gaussians(9, 1))
    tree = splatree.build_lod(Scene.flat(random_gaussians(6, 2)), splatree.BuildOptions(max_roots=2))
    paths = []
    for number, scene in enumerate((flat, tree)):
        counted = [name for name in ("compression", "format_version", "sh_bits") if name in chosen.options]
        switches = [("compact", True)] if "compact" in chosen.options else []
        for field, value in [("", None), *switches, *((name, v) for name in counted for v in range(9))]:
            path = folder / f"{number}{field}{value}{chosen.suffixes[0]}"
            try:
                splatree.write(scene, path, options=WriteOptions(**{field: value} if field else {}))
                paths.append(path)
            except splatree.SplatreeError:
                pass  # a value that the option does not have
    if kind == "sog":
        write_sog(folder / "scene", n=9)
        bundle(folder / "scene", folder / "b.sog")
        paths.append(folder / "b.sog")
    if kind == "ply":
        paths += [_ascii_ply(folder / "ascii.ply"), _ascii_ply(folder / "big.ply", big_endian=True)]
    if kind == "rad":
        paths.append(_plain_rad(folder / "plain.rad"))
    return paths


def _folder_seed(kind: str, folder: Path) -> Path:
    """A small tree as a folder of parts, or as tiles; its JSON file."""
    scene = Scene.flat(random_gaussians(60, 1))
    if kind == "3d-tiles":
        splatree.stream(splatree.build_lod(scene), folder / "scene", "3dtiles")
        return folder / "scene" / "tileset.json"
    splatree.write(scene, folder / "scene.ply")
    options = splatree.BuildOptions(method="radius", max_roots=2, follow=False)
    splatree.build_folder(folder / "scene.ply", folder / "scene", options, splatree.FolderOptions(part_rows=20))
    return folder / "scene" / "manifest.json"


def _ascii_ply(path: Path, *, big_endian: bool = False) -> Path:
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    kind = "binary_big_endian" if big_endian else "ascii"
    lines = [
        "ply",
        f"format {kind} 1.0",
        "element vertex 3",
        *(f"property double {n}" for n in names),
        "end_header",
        "",
    ]
    rows = np.random.default_rng(0).standard_normal((3, len(names)))
    body = rows.astype(">f8").tobytes() if big_endian else "\n".join(" ".join(map(str, row)) for row in rows).encode()
    path.write_bytes("\n".join(lines).encode() + body + b"\n" * (not big_endian))
    return path


def _plain_rad(path: Path) -> Path:
    """Without compression, with a palette and a tree."""

    def zeros(name: str, encoding: str, size: int, **entry: float) -> tuple[dict, bytes]:
        return ({"property": name, "encoding": encoding, **entry}, bytes(size))

    properties = [
        zeros("center", "f16_lebytes", 18),
        zeros("alpha", "r8", 3, min=0, max=2),
        zeros("rgb", "r8_delta", 9, min=0, max=1),
        zeros("scales", "ln_0r8", 9, min=-9, max=1),
        zeros("orientation", "oct88r8", 9),
        zeros("sh1_code", "s8_delta", 18, min=-1, max=1),
        zeros("sh_label", "u16", 6),
        ({"property": "child_count", "encoding": "u16"}, np.array([2, 0, 0], "<u2").tobytes()),
        ({"property": "child_start", "encoding": "u32"}, np.array([1, 0, 0], "<u4").tobytes()),
    ]
    data = chunk(properties, count=3, compress=False)
    return write_rad(path, [data], count=3, maxSh=1, lodTree=True, shCodeCount=2)
