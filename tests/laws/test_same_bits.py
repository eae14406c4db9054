"""Pictures, selections and files keep their bits: hashes of what this version gives are compared with stored ones.

A change that is meant to alter a picture or a file stores new hashes with ``python -m tests.laws.test_same_bits`` and says so.
Everything runs on the baseline instruction set. Where NumPy's elementary functions round otherwise than on the machine that
stored the hashes, nothing can be said and the tests are skipped.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Iterator
from dataclasses import fields
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest

import splatree as st
from splatree.kernels.cpu import _core

STORED = Path(__file__).with_name("same_bits.json")
MODES = ("classic", "antialiased")
METHODS = ("radius", "pairs")
PACKED = (".spz", ".sog", ".rad")  # compressed by libraries, whose versions differ: what is read back counts
PLAIN = (".ply", ".compressed.ply", ".splat", ".ksplat", ".hier", ".glb")


def digest(*arrays: np.ndarray | bytes) -> str:
    state = hashlib.sha256()
    for array in arrays:
        state.update(array if isinstance(array, bytes) else np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:16]


def columns(gaussians: st.Gaussians) -> list[np.ndarray]:
    return [getattr(gaussians, field.name) for field in fields(gaussians)]


def rounding() -> str:
    """Changes where NumPy's functions round in another way."""
    x = np.linspace(0.01, 20, 4001)
    parts = [f(x.astype(t)) for f in (np.exp, np.log, np.sin, np.cos, np.log1p) for t in (np.float32, np.float64)]
    return digest(*parts, np.linspace(1, 2, 900).reshape(30, 30) @ np.linspace(0, 1, 90).reshape(30, 3))


def piece() -> st.Scene:
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        scene = st.read(path)
    rows = np.argsort(np.linalg.norm(scene.gaussians.means - np.median(scene.gaussians.means, axis=0), axis=1))
    return st.Scene.flat(scene.gaussians.take(np.sort(rows[:6000])))


def frames() -> Iterator[tuple[str, str]]:
    flat = piece()
    for mode in MODES:
        scene = st.Scene.flat(flat.gaussians, mode=mode)
        for method in METHODS:
            tree = st.build_clusters(st.build_lod(scene, st.BuildOptions(method=method)), 64)
            yield f"tree {mode} {method}", digest(*columns(tree.gaussians), *tree_columns(tree))
            for camera in st.flyout(tree, st.PathOptions(views=3, up=(0, -1, 0), width=200, height=120)):
                for name, render, select in views():
                    frame = st.trace(tree, camera, render, select)
                    found = digest(frame.selection.rows, frame.splats.records, frame.bins.splat_from_pair)
                    yield f"frame {mode} {method} {name} {camera.name}", found
                    result = frame.result
                    yield (
                        f"picture {mode} {method} {name} {camera.name}",
                        digest(result.image, result.alpha, result.depth),
                    )
        for keep in (0.5, 0.1):
            thinned = st.thin(scene, st.ThinOptions(keep=keep)).scene.gaussians
            yield f"thin {mode} {keep}", digest(*columns(thinned))


def tree_columns(scene: st.Scene) -> list[np.ndarray]:
    return [getattr(scene.tree, name) for name in ("subtree_end", "depth", "extents")]


def views() -> Iterator[tuple[str, st.RenderOptions, st.SelectOptions]]:
    yield "cut", st.RenderOptions(), st.SelectOptions()
    yield "leaves", st.RenderOptions(), st.SelectOptions(pixel_error=0.0)
    yield "budget", st.RenderOptions(), st.SelectOptions(budget=800)
    yield "squares", st.RenderOptions(tile_rule="tau", threshold=0.02), st.SelectOptions(rule="release")
    yield "tapered", st.RenderOptions(pixels="taper", threshold=0.03, tile_rule="balanced"), st.SelectOptions()


def stored_files(folder: Path) -> Iterator[tuple[str, str]]:
    tree = st.build_lod(piece(), st.BuildOptions("radius"))
    for suffix in (*PLAIN, *PACKED):
        path = folder / f"piece{suffix}"
        st.write(tree, path, force=True)
        if suffix in PACKED:
            back = st.read(path)
            yield f"file {suffix}", digest(*columns(back.gaussians), *tree_columns(back))
        else:
            yield f"file {suffix}", digest(path.read_bytes())


def found() -> dict[str, str]:
    before = _core.isa()
    _core.use_isa(_core.isas()[-1])
    try:
        with tempfile.TemporaryDirectory() as folder:
            return {"rounding": rounding(), **dict(frames()), **dict(stored_files(Path(folder)))}
    finally:
        _core.use_isa(before)


def test_pictures_selections_and_files_keep_their_bits():
    stored = json.loads(STORED.read_text())
    if stored["isa"] != _core.isas()[-1]:
        pytest.skip(f"hashes are of instruction set {stored['isa']}")
    if stored["hashes"]["rounding"] != rounding():
        pytest.skip("NumPy's elementary functions round otherwise here than where the hashes were stored")
    changed = {name: value for name, value in found().items() if stored["hashes"].get(name) != value}
    assert changed == {}


if __name__ == "__main__":
    STORED.write_text(json.dumps({"isa": _core.isas()[-1], "hashes": found()}, indent=1) + os.linesep)
