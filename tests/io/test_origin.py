"""Coordinates far from zero: moved in float64, kept relative to an origin, and given back."""

import json

import numpy as np
import pytest

import splatree as st
from splatree import EditOptions, Gaussians, Scene
from splatree.io.convert import ConvertOptions
from splatree.scene.origin import coarsest_step, origin_of
from splatree.scene.scene import Source

from ..scenes import random_gaussians
from .conftest import same_bits
from .test_ply_properties import columns_of, save

FAR = np.array([500000.0, 4500000.0, 0.0])
GAUSSIANS = random_gaussians(300, degree=0)


@pytest.fixture
def world():
    """Coordinates in double precision, some metres around a place in UTM."""
    return np.random.default_rng(2).normal(0, 0.6, (300, 3)) + FAR + (0, 0, 120)


def in_world(scene):
    return scene.gaussians.means.astype(np.float64) + np.asarray(scene.source.origin)


@pytest.fixture
def utm(tmp_path, world):
    columns = columns_of(GAUSSIANS) | dict(zip("xyz", world.T.copy(), strict=True))
    return save(tmp_path / "utm.ply", columns)


def test_doubles_are_read_relative_to_an_origin(utm, world):
    scene = st.read(utm)
    assert scene.source.origin == (500000, 4500000, 0)
    np.testing.assert_allclose(in_world(scene), world, atol=1e-5)
    assert len(np.unique(scene.gaussians.means[:, 1])) == 300


def test_translating_keeps_every_height(utm, world, tmp_path):
    edit = EditOptions(translate=(-500000.0, -4500000.0, 0.0))
    done = st.convert(utm, tmp_path / "local.ply", ConvertOptions(edit=edit))
    scene = st.read(tmp_path / "local.ply")
    assert scene.source.origin == (0, 0, 0) and done.notes == ()
    np.testing.assert_allclose(scene.gaussians.means, world - FAR, atol=1e-5)
    # Whole scenes move like chunks.
    assert same_bits(st.edit(st.read(utm), edit).gaussians.means, scene.gaussians.means)


def test_other_moves_and_crops_are_in_the_world(utm, world, tmp_path):
    turn = EditOptions(scale=2.0, rotate=(0.0, 0.0, 90.0), translate=(9000000.0, 0.0, 7.0))
    wanted = 2 * world @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + (9000000, 0, 7)
    np.testing.assert_allclose(in_world(st.edit(st.read(utm), turn)), wanted, atol=1e-4)
    centre = (*world[0], 0.5)
    near = np.linalg.norm(world - world[0], axis=1) <= 0.5
    assert len(st.edit(st.read(utm), EditOptions(crop_sphere=centre))) == near.sum() > 1
    st.convert(utm, tmp_path / "near.ply", ConvertOptions(edit=EditOptions(crop_sphere=centre)))
    np.testing.assert_allclose(in_world(st.read(tmp_path / "near.ply")), world[near], atol=1e-5)


@pytest.mark.parametrize("suffix", ["ply", "splatree", "glb"])
def test_formats_that_can_hold_an_origin_give_it_back(utm, world, tmp_path, suffix):
    scene = st.read(utm)
    lost = st.write(scene, tmp_path / f"a.{suffix}")
    again = st.read(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(in_world(again), world, atol=1e-5)
    assert not any("origin" in sentence for sentence in lost)
    if suffix == "splatree":
        assert again.source.origin == scene.source.origin and same_bits(again.gaussians.means, scene.gaussians.means)


@pytest.mark.parametrize("suffix", ["spz", "splat", "sog", "ksplat", "compressed.ply"])
def test_other_formats_say_that_they_are_relative(utm, tmp_path, suffix):
    lost = st.convert(utm, tmp_path / f"a.{suffix}").lost
    assert any("the origin (500000, 4500000, 0)" in sentence for sentence in lost)


def test_a_scene_that_is_moved_far_off_keeps_its_precision(tmp_path):
    scene = Scene.flat(GAUSSIANS)
    st.write(scene, tmp_path / "a.ply")
    st.convert(tmp_path / "a.ply", tmp_path / "b.ply", ConvertOptions(edit=EditOptions(translate=tuple(FAR))))
    np.testing.assert_allclose(in_world(st.read(tmp_path / "b.ply")), GAUSSIANS.means + FAR, atol=1e-4)
    near = st.edit(scene, EditOptions(translate=(100.0, 0.0, 0.0)))
    assert near.source.origin == (0, 0, 0)


def test_joined_inputs_have_the_origin_of_the_first(utm, world, tmp_path):
    other = save(tmp_path / "other.ply", columns_of(GAUSSIANS) | dict(zip("xyz", (world + 2000).T.copy(), strict=True)))
    both = st.read([utm, other])
    assert both.source.origin == (500000, 4500000, 0)
    np.testing.assert_allclose(in_world(both), np.concatenate([world, world + 2000]), atol=1e-3)
    st.convert([utm, other], tmp_path / "joined.ply")
    np.testing.assert_allclose(in_world(st.read(tmp_path / "joined.ply")), in_world(both), atol=1e-3)


@pytest.mark.parametrize("in_memory", [False, True])
def test_inputs_far_from_the_first_are_told_to_lose_their_places(utm, tmp_path, in_memory):
    """Half a metre there: a scene near zero and one of UTM have no place in one float32 scene."""
    near = save(tmp_path / "near.ply", columns_of(GAUSSIANS))
    for paths, far in (([near, utm], utm), ([utm, near], near)):
        if in_memory:
            lost = json.loads(st.read(paths).source.metadata["lost"])
        else:
            lost = st.convert(paths, tmp_path / "both.ply", force=True).lost
        assert len(lost) == 1 and f"the places of {far}: so far" in lost[0] and "steps of 0.5 world units" in lost[0]


def test_text_and_big_endian_files_too(utm, world, tmp_path):
    head, _, data = utm.read_bytes().partition(b"end_header\n")
    names = [line.split()[2].decode() for line in head.split(b"\n") if line.startswith(b"property")]
    kinds = ["<f8" if name in "xyz" else "<f4" for name in names]
    records = np.frombuffer(data, list(zip(names, kinds, strict=True)))
    text = head.replace(b"binary_little_endian", b"ascii").replace(b"double", b"float") + b"end_header\n"
    rows = "\n".join(" ".join(repr(float(value)) for value in row) for row in records) + "\n"
    (tmp_path / "text.ply").write_bytes(text + rows.encode())
    big = records.astype([(name, kind.replace("<", ">")) for name, kind in zip(names, kinds, strict=True)])
    (tmp_path / "big.ply").write_bytes(head.replace(b"little", b"big") + b"end_header\n" + big.tobytes())
    for name in ("text.ply", "big.ply"):
        np.testing.assert_allclose(in_world(st.read(tmp_path / name)), world, atol=1e-5)


def test_nodes_of_gltf_and_cesium_rtc_move_in_float64(tmp_path):
    st.write(Scene.flat(GAUSSIANS), tmp_path / "a.glb")
    place = [500000.25, -3.5, 4500000.125]
    for name, change in {
        "translation": {"nodes": [{"mesh": 0, "translation": place}]},
        "matrix": {"nodes": [{"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *place, 1]}]},
        "rtc": {"extensions": {"CESIUM_RTC": {"center": place}}, "extensionsUsed": ["CESIUM_RTC"]},
        "parents": {
            "nodes": [
                {"translation": [500000, -3.5, 4500000], "children": [1]},
                {"mesh": 0, "translation": [0.25, 0, 0.125]},
            ]
        },
    }.items():
        rewrite_json(tmp_path / "a.glb", tmp_path / f"{name}.glb", change)
        scene = st.read(tmp_path / f"{name}.glb")
        # x and y of glTF are the other way round here.
        wanted = GAUSSIANS.means.astype(np.float64) + (-place[0], -place[1], place[2])
        np.testing.assert_allclose(in_world(scene), wanted, atol=2e-5)
        assert max(map(abs, scene.source.origin)) >= 4000000


def test_cameras_follow_the_origin(utm, world, tmp_path):
    scene = st.read(utm)
    camera = st.Camera.look_at(FAR + (0, 0, 110), FAR + (0, 0, 120), width=64, height=48)
    st.write_cameras([camera], tmp_path / "cameras.json")
    (moved,) = st.read_cameras(tmp_path / "cameras.json", source=scene.source)
    np.testing.assert_allclose(moved.position, (0, 0, 110), atol=1e-6)
    local = Gaussians(
        (world - FAR).astype(np.float32), GAUSSIANS.quats, GAUSSIANS.log_scales, GAUSSIANS.logit_opacities, GAUSSIANS.sh
    )
    np.testing.assert_allclose(st.render(scene, moved).image, st.render(Scene.flat(local), moved).image, atol=1e-3)


def test_an_origin_is_taken_only_where_float32_is_coarse():
    points, scales = np.random.default_rng(0).normal(0, 10, (1000, 3)), np.full((1000, 3), -4, np.float32)
    assert origin_of(points, scales) == (0, 0, 0)
    assert origin_of(points + (1000, 0, 0), scales) == (0, 0, 0)
    assert origin_of(points + (3e5, 0, 0), scales) == (300000, 0, 0)
    assert origin_of(points[:0], scales[:0]) == (0, 0, 0)
    assert origin_of(points * 1e6, scales) == (0, 0, 0)  # as wide as it is far
    assert coarsest_step(4.5e6) == 0.5


def test_a_scene_without_an_origin_is_stored_as_before(tmp_path):
    st.write(Scene.flat(GAUSSIANS), tmp_path / "a.splatree")
    assert b"world_origin" not in (tmp_path / "a.splatree").read_bytes()
    source = Source(metadata={"a": "b"}, origin=(1.0, 2.5, -1e7))
    st.write(Scene.flat(GAUSSIANS, source=source), tmp_path / "b.splatree")
    again = st.read(tmp_path / "b.splatree").source
    assert again.origin == (1.0, 2.5, -1e7) and again.metadata["a"] == "b"


def rewrite_json(source, target, change):
    data = source.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    content = json.loads(data[20 : 20 + length]) | change
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    body = len(text).to_bytes(4, "little") + data[16:20] + text + data[20 + length :]
    target.write_bytes(data[:8] + (12 + len(body)).to_bytes(4, "little") + body)
