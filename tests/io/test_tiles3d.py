"""3D Tiles: the finest tiles of a tileset, where its matrices put them."""

import json

import numpy as np
import pytest

import splatree as st
from splatree import FormatError, Scene

from ..scenes import random_gaussians
from .conftest import same_bits

A, B, C = (random_gaussians(n, degree=1, seed=n) for n in (5, 7, 9))


def moved(*by):
    """A matrix column by column that moves, z up."""
    return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *by, 1]


def tileset(folder, root, *parts):
    folder.mkdir(parents=True, exist_ok=True)
    for name, g in parts:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        st.write(Scene.flat(g), folder / name)
    (folder / "tileset.json").write_text(json.dumps({"asset": {"version": "1.1"}, "geometricError": 1, "root": root}))
    return folder


def in_world(scene):
    return scene.gaussians.means.astype(np.float64) + np.asarray(scene.source.origin)


def test_the_finest_tiles_are_read(tmp_path):
    root = {
        "refine": "REPLACE",
        "content": {"uri": "coarse.glb"},
        "children": [{"content": {"uri": "a.glb"}}, {"contents": [{"uri": "in/b.glb"}]}],
    }
    folder = tileset(tmp_path / "t", root, ("coarse.glb", C), ("a.glb", A), ("in/b.glb", B))
    for path in (folder, folder / "tileset.json"):
        scene = st.read(path)
        assert len(scene) == 12 and scene.source.format == "3d-tiles"
    assert same_bits(scene.gaussians.means[:5], A.means) and same_bits(
        scene.gaussians.quats[:5], st.read(folder / "a.glb").gaussians.quats
    )
    root["refine"] = "ADD"
    assert len(st.read(tileset(tmp_path / "t", root))) == 21
    assert st.convert(folder, tmp_path / "b.ply").num_read == 21


def test_transforms_are_z_up_and_multiply(tmp_path):
    root = {"transform": moved(10, 20, 30), "children": [{"transform": moved(1, 2, 3), "content": {"uri": "a.glb"}}]}
    scene = st.read(tileset(tmp_path / "t", root, ("a.glb", A)))
    # East, north and up of tiles are x left, z and −y here: right is −x of glTF's left.
    np.testing.assert_allclose(in_world(scene), A.means + np.float64([-11, -33, -22]), atol=1e-4)


def test_a_turn_about_up_turns_the_scene(tmp_path):
    quarter = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    scene = st.read(tileset(tmp_path / "t", {"transform": quarter, "content": {"uri": "a.glb"}}, ("a.glb", A)))
    np.testing.assert_allclose(scene.gaussians.means[:, 1], A.means[:, 1], atol=1e-5)  # up stays
    flat = np.linalg.norm(A.means[:, ::2], axis=1)
    np.testing.assert_allclose(np.linalg.norm(scene.gaussians.means[:, ::2], axis=1), flat, rtol=1e-5)
    np.testing.assert_allclose(scene.gaussians.means[:, 0], -A.means[:, 2], atol=1e-5)


def test_the_globe_is_left_out_and_noted(tmp_path):
    matrix = moved(4e6, 5e5, 4.9e6)
    root = {"transform": matrix, "children": [{"transform": moved(1000, 0, 0), "content": {"uri": "a.glb"}}]}
    scene = st.read(tileset(tmp_path / "t", root, ("a.glb", A)))
    np.testing.assert_allclose(in_world(scene), A.means + np.float64([-1000, 0, 0]), atol=1e-3)
    assert json.loads(scene.source.metadata["globe_transform"]) == matrix
    assert "globe is left out" in json.loads(scene.source.metadata["notes"])[0]


def test_far_transforms_keep_their_digits(tmp_path):
    root = {"transform": moved(500000.25, 4500000.125, 100), "content": {"uri": "a.glb"}}
    scene = st.read(tileset(tmp_path / "t", root, ("a.glb", A)))
    np.testing.assert_allclose(in_world(scene), A.means + np.float64([-500000.25, -100, -4500000.125]), atol=1e-4)
    assert any(scene.source.origin)


def test_transforms_that_stretch_are_followed(tmp_path):
    """Twice as wide along x, which points the other way in a scene."""
    root = {"transform": np.diag([2.0, 1, 1, 1]).ravel().tolist(), "content": {"uri": "a.glb"}}
    scene = st.read(tileset(tmp_path / "t", root, ("a.glb", A)))
    np.testing.assert_allclose(scene.gaussians.means, A.means * [2, 1, 1], atol=1e-6)


def test_tilesets_within_tilesets(tmp_path):
    tileset(tmp_path / "t" / "inner", {"content": {"uri": "b.glb"}}, ("b.glb", B))
    folder = tileset(tmp_path / "t", {"transform": moved(1, 0, 0), "content": {"uri": "inner/tileset.json"}})
    assert len(st.read(folder)) == 7
    tileset(tmp_path / "t" / "inner", {"content": {"uri": "../tileset.json"}})
    with pytest.raises(FormatError, match="a tileset within itself"):
        st.read(folder)


@pytest.mark.parametrize(
    ("root", "message"),
    [
        ({"content": {"uri": "../../a.glb"}}, "inside the folder"),
        ({"content": {"uri": "gone.glb"}}, "cannot be read"),
        ({"content": {"uri": "a.pnts"}}, r"found no glTF in its tiles \(1 .pnts\)"),
        ({"content": {"uri": "a.glb"}, "transform": [1, 2]}, "transform: found numbers of shape"),
        ({"content": {"uri": "a.glb"}, "transform": [0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}, "flattens"),
        ({"content": {"uri": "a.glb"}, "implicitTiling": {}}, "implicitTiling"),
        ({"children": [7]}, "wanted an object"),
        ({}, "no contents"),
    ],
)
def test_bad_tilesets_are_refused(tmp_path, root, message):
    with pytest.raises(FormatError, match=message):
        st.read(tileset(tmp_path / "t", root, ("a.glb", A)))


def test_tiles_of_other_kinds_are_named_as_lost(tmp_path):
    root = {"content": {"uri": "a.glb"}, "refine": "ADD", "children": [{"content": {"uri": "b.pnts"}}]}
    scene = st.read(tileset(tmp_path / "t", root, ("a.glb", A)))
    assert json.loads(scene.source.metadata["lost"]) == ["tiles of other kinds: 1 .pnts"]
