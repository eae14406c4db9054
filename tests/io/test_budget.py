"""Hostile inputs: a few bytes cannot ask for gigabytes, nor for files outside of a scene's folder."""

import json
import os

import numpy as np
import pytest

import splatree as st
from splatree import FormatError, Scene
from splatree.io import budget
from splatree.io.budget import RowBudget

from ..scenes import random_gaussians
from .sog_files import write_sog
from .test_origin import rewrite_json


@pytest.fixture
def strict(monkeypatch):
    """A budget for files of tests: 100 rows are allowed of whatever bytes."""
    monkeypatch.setattr(budget, "ROWS_ALWAYS", 100)


def test_a_budget_counts_each_file_once(tmp_path, strict):
    (tmp_path / "a").write_bytes(bytes(100))
    (tmp_path / "b").symlink_to(tmp_path / "a")
    rows = RowBudget("here", rows_per_byte=2)
    for name in ("a", "b", "a"):
        rows.add_file(tmp_path / name)
    rows.take(200)
    with pytest.raises(FormatError, match="here: found 201 Gaussians or more from 100 bytes, wanted at most 200"):
        rows.take(1)


def streamed(folder, names, n=60):
    write_sog(folder / "unit", n=n)
    leaves = [{"lods": {"0": {"file": i, "offset": 0, "count": n}}} for i in range(len(names))]
    meta = {"version": 1, "lodLevels": 1, "filenames": names, "tree": {"children": leaves}}
    (folder / "lod-meta.json").write_text(json.dumps(meta))


@pytest.mark.parametrize("again", ["unit/meta.json", "./unit/meta.json", "unit", "link/meta.json"])
def test_a_unit_that_is_named_again_is_drawn_once_or_refused(tmp_path, again):
    streamed(tmp_path, ["unit/meta.json", again])
    (tmp_path / "link").symlink_to(tmp_path / "unit")
    with pytest.raises(FormatError, match="overlap; its rows would be drawn twice"):
        st.read(tmp_path)


def test_an_environment_is_budgeted_with_the_units(tmp_path, monkeypatch, strict):
    monkeypatch.setattr("splatree.io.formats.streamed_sog.format.RowBudget", lambda where: RowBudget(where, 0.001))
    streamed(tmp_path, ["unit/meta.json"])
    assert len(st.read(tmp_path)) == 60
    meta = json.loads((tmp_path / "lod-meta.json").read_text()) | {"environment": "unit/meta.json"}
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    with pytest.raises(FormatError, match="found 120 Gaussians or more"):
        st.read(tmp_path)


def test_primitives_on_shared_accessors_are_budgeted(tmp_path, monkeypatch):
    st.write(Scene.flat(random_gaussians(200, 0)), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    primitive = json.loads(data[20 : 20 + length])["meshes"][0]["primitives"][0]
    monkeypatch.setattr(budget, "ROWS_ALWAYS", 1000)
    rewrite_json(tmp_path / "a.glb", tmp_path / "few.glb", {"meshes": [{"primitives": [primitive] * 4}]})
    assert len(st.read(tmp_path / "few.glb")) == 800
    rewrite_json(tmp_path / "a.glb", tmp_path / "many.glb", {"meshes": [{"primitives": [primitive] * 600}]})
    with pytest.raises(FormatError, match="parts are named again and again"):
        st.read(tmp_path / "many.glb")
    nodes = {"nodes": [{"mesh": 0}] * 600, "scenes": [{"nodes": list(range(600))}]}
    rewrite_json(tmp_path / "a.glb", tmp_path / "nodes.glb", nodes)
    with pytest.raises(FormatError, match="parts are named again and again"):
        st.read(tmp_path / "nodes.glb")


def test_joined_inputs_are_budgeted_together(tmp_path, monkeypatch):
    monkeypatch.setattr(budget, "ROWS_ALWAYS", 100)
    paths = []
    for i in range(3):
        write_sog(tmp_path / f"u{i}", n=60, seed=i)
        paths.append(tmp_path / f"u{i}")
    assert len(st.read(paths)) == 180  # within 16 rows a byte
    monkeypatch.setattr(RowBudget, "take", _take_few)
    with pytest.raises(FormatError, match="too many"):
        st.read(paths)
    with pytest.raises(FormatError, match="too many"):
        st.convert(paths, tmp_path / "b.ply")


def _take_few(self, rows):
    self.num_rows += rows
    if self.num_rows > 100:
        raise FormatError("too many")


def test_a_file_that_is_named_twice_is_told(tmp_path, strict):
    st.write(Scene.flat(random_gaussians(5, 0)), tmp_path / "a.ply")
    (tmp_path / "b.ply").symlink_to(tmp_path / "a.ply")
    for paths in ([tmp_path / "a.ply"] * 2, [tmp_path / "a.ply", tmp_path / "b.ply"]):
        scene = st.read(paths)
        assert len(scene) == 10 and "a.ply is named 2 times" in json.loads(scene.source.metadata["notes"])[-1]
        assert "a.ply is named 2 times" in st.convert(paths, tmp_path / "c.ply", force=True).notes[0]


@pytest.mark.parametrize("name", ["means_l.webp", "meta.json"])
def test_sog_folders_do_not_follow_links_out(tmp_path, name):
    write_sog(tmp_path / "s")
    (tmp_path / "secret").write_bytes((tmp_path / "s" / name).read_bytes())
    (tmp_path / "s" / name).unlink()
    (tmp_path / "s" / name).symlink_to(tmp_path / "secret")
    with pytest.raises(FormatError, match="leads out of its folder"):
        st.read(tmp_path / "s")


def test_sog_folders_open_neither_devices_nor_pipes(tmp_path):
    write_sog(tmp_path / "s")
    (tmp_path / "s" / "quats.webp").unlink()
    os.mkfifo(tmp_path / "s" / "quats.webp")
    with pytest.raises(FormatError, match="is no plain file"):
        st.read(tmp_path / "s")
    (tmp_path / "s" / "quats.webp").unlink()
    (tmp_path / "s" / "quats.webp").symlink_to("/dev/zero")
    with pytest.raises(FormatError, match="leads out of its folder"):
        st.read(tmp_path / "s")


def test_streamed_units_do_not_lie_outside(tmp_path):
    streamed(tmp_path / "in", ["link/meta.json"])
    (tmp_path / "in" / "unit").rename(tmp_path / "outside")
    (tmp_path / "in" / "link").symlink_to(tmp_path / "outside")
    with pytest.raises(FormatError, match="leads out of its folder"):
        st.read(tmp_path / "in")


@pytest.mark.parametrize("shape", [[0, 2**31 - 1, 2**31 - 1, 2**31 - 1], [0] + [2**30] * 7, [2**31 - 1] * 3])
def test_shapes_of_splatree_whose_product_overflows_are_refused(tmp_path, shape):
    st.write(Scene.flat(random_gaussians(4, 0)), tmp_path / "a.splatree")
    data = (tmp_path / "a.splatree").read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    header["clusters.start"] = {"dtype": "U8", "shape": shape, "data_offsets": [0, 0]}
    text = json.dumps(header, separators=(",", ":")).encode()
    (tmp_path / "b.splatree").write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])
    with pytest.raises(FormatError, match=r"which no file holds|found bytes"):
        st.read(tmp_path / "b.splatree")
    assert np.isfinite(st.read(tmp_path / "a.splatree").gaussians.means).all()
