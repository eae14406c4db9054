"""3D Tiles: children replace their parent exactly, boxes hold, errors fall, and the numbers are in Cesium's axes."""

import io
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

import splatree as st
from splatree.io.formats.spz.container import Planes
from splatree.lod.select import count_nested, count_uncovered
from splatree.maths.covariance import covariances_from_gaussians
from splatree.stream.earth import ecef_from_enu
from splatree.stream.readers.cesium import open_tileset, select_cesium
from splatree.stream.stream import stream
from splatree.stream.tiles import tiles_of_tree

from .conftest import forest

OPTIONS = st.StreamOptions(tile_nodes=120)


@pytest.fixture(scope="module")
def scene():
    return forest(1200, seed=9, sh_degree=1)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("tiles") / "out"
    stream(scene, path, "3dtiles", OPTIONS)
    return path


def manifest_of(folder):
    return json.loads((folder / "tileset.json").read_text())


def nodes_of(node):
    return [node, *(below for child in node.get("children", ()) for below in nodes_of(child))]


@given(some.integers(1, 400), some.integers(1, 5), some.integers(0, 1000), some.integers(4, 80), some.randoms())
@settings(max_examples=40, deadline=None)
def test_whatever_tiles_are_refined_is_a_cut(n, num_roots, seed, tile_nodes, random):
    scene = forest(max(n, num_roots), seed=seed, num_roots=num_roots)
    tiles = tiles_of_tree(scene, tile_nodes)
    drawn, pending = [], [0]
    while pending:
        tile = tiles[pending.pop()]
        if tile.children and random.random() < 0.7:
            pending += tile.children
        else:
            drawn.append(tile.rows)
    rows = np.concatenate(drawn)
    assert count_nested(scene.tree, rows) == 0
    assert count_uncovered(scene.tree, rows) == 0
    for tile in tiles:
        assert all(tiles[child].size < tile.size for child in tile.children)
        assert bool(tile.children) == (tile.size > 0)
        if tile.size == 0:
            assert scene.tree.is_leaf[tile.rows].all()


def test_tiles_have_at_most_so_many_nodes(city_tree):
    tiles = tiles_of_tree(city_tree, 10_000)
    assert max(len(tile.rows) for tile in tiles) <= 10_000
    assert sum(len(tile.rows) for tile in tiles if tile.size == 0) == city_tree.tree.num_leaves
    assert len(tiles[0].rows) > 2_000  # the root is not a blur


def test_both_extensions_are_required_of_every_tile(folder):
    manifest = manifest_of(folder)
    assert manifest["asset"]["version"] == "1.1"
    required = manifest["extensions"]["3DTILES_content_gltf"]["extensionsRequired"]
    assert required == ["KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"]
    nodes = nodes_of(manifest["root"])
    assert len(nodes) > 5 and {node["refine"] for node in nodes} == {"REPLACE"}
    assert {path.name for path in folder.iterdir()} == {node["content"]["uri"] for node in nodes} | {"tileset.json"}
    assert manifest["geometricError"] > manifest["root"]["geometricError"] > 0
    for node in nodes:
        for child in node.get("children", ()):
            assert child["geometricError"] < node["geometricError"]


def test_geometric_errors_are_those_of_nodes_three_pixels_large(scene, folder):
    errors = [node["geometricError"] for node in nodes_of(manifest_of(folder)["root"])]
    sizes = [tile.size for tile in tiles_of_tree(scene, OPTIONS.tile_nodes)]
    np.testing.assert_allclose(sorted(errors), np.sort(sizes) * 16 / 3)


def test_tiles_read_back_and_lie_in_their_boxes(scene, folder):
    tiles, read = tiles_of_tree(scene, OPTIONS.tile_nodes), open_tileset(folder)
    assert len(tiles) == len(read.names)
    for index, name in enumerate(read.names):
        number = int(name.split("-")[0].split("_")[1])
        back = st.read(folder / name).gaussians
        wanted = scene.gaussians.take(tiles[number].rows)
        np.testing.assert_allclose(back.means, wanted.means, atol=2**-12)  # 24 bits with 12 of them fractional
        np.testing.assert_allclose(back.sh[:, 0], wanted.sh[:, 0], atol=0.02)
        low, high = read.boxes[index]
        covariances = covariances_from_gaussians(wanted.quats, wanted.log_scales)
        reach = 3 * np.sqrt(np.einsum("nii->ni", covariances))
        assert np.all(low <= (wanted.means - reach).min(axis=0) + 1e-9)
        assert np.all(high >= (wanted.means + reach).max(axis=0) - 1e-9)
        if read.parents[index] >= 0:
            above = read.boxes[read.parents[index]]
            assert np.all(above[0] <= low + 1e-9) and np.all(above[1] >= high - 1e-9)


def test_a_stream_reads_back_as_the_leaves(scene, folder):
    leaves, back = scene.gaussians.take(scene.tree.is_leaf).means, st.read(folder).gaussians.means
    assert len(back) == len(leaves)
    for axis in range(3):
        np.testing.assert_allclose(np.sort(back[:, axis]), np.sort(leaves[:, axis]), atol=2**-11)


def test_the_numbers_inside_are_in_the_axes_of_gltf(scene, folder):
    """Cesium takes them as they are: x left, y up, z front, for a scene of x right, y down, z front."""
    tile = tiles_of_tree(scene, OPTIONS.tile_nodes)[0]
    data = (folder / manifest_of(folder)["root"]["content"]["uri"]).read_bytes()
    length = int.from_bytes(data[12:16], "little")
    content = json.loads(data[20 : 20 + length])
    assert content["asset"]["extras"] == {"splatree_spz_axes": "LUF"}
    packed = data[28 + length :][: content["bufferViews"][0]["byteLength"]]
    planes = Planes(io.BytesIO(packed), len(packed), "tile")
    assert planes.axes is None and planes.header.version == 2
    positions = bytes(next(iter(planes.open(io.BytesIO(packed))(len(tile.rows))))[1])
    codes = np.frombuffer(positions, np.uint8).reshape(-1, 3, 3).astype(np.int32)
    values = codes[..., 0] | codes[..., 1] << 8 | codes[..., 2] << 16
    values = np.where(values >= 1 << 23, values - (1 << 24), values) * 2.0**-planes.header.fractional_bits
    means = scene.gaussians.means[tile.rows] * [-1, -1, 1]
    np.testing.assert_allclose(values, means, atol=2**-12)
    bounds = content["accessors"][0]
    np.testing.assert_allclose([bounds["min"], bounds["max"]], [means.min(axis=0), means.max(axis=0)], atol=1e-6)


def test_the_bytes_do_not_depend_on_threads_and_a_stream_goes_on(scene, folder, tmp_path):
    whole = {path.name: path.read_bytes() for path in folder.iterdir()}
    stream(scene, tmp_path / "one", "3dtiles", OPTIONS, threads=1)
    assert {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()} == whole
    (tmp_path / "one" / "tileset.json").unlink()
    removed = sorted((tmp_path / "one").iterdir())[0]
    removed.unlink()
    done = stream(scene, tmp_path / "one", "3dtiles", OPTIONS)
    assert done.num_parts_kept == done.num_parts - 1
    assert {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()} == whole


@pytest.mark.parametrize(
    ("origin", "position"),
    [
        ((0, 0, 0), (6378137, 0, 0)),
        ((90, 0, 0), (0, 0, 6356752.314245)),
        ((0, 90, 100), (0, 6378237, 0)),
        ((48.8584, 2.2945, 35), (4200952.5, 168330.5, 4780235.2)),  # the Eiffel tower
    ],
)
def test_a_scene_stands_where_its_origin_says(origin, position):
    matrix = ecef_from_enu(*origin)
    np.testing.assert_allclose(matrix[:3, 3], position, atol=150 if origin[0] == 48.8584 else 1e-3)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    up = matrix[:3, 3] / np.linalg.norm(matrix[:3, 3])
    assert matrix[:3, 2] @ up > 0.999 and np.linalg.det(matrix[:3, :3]) > 0


def test_the_transform_is_column_by_column(scene, tmp_path):
    stream(scene, tmp_path / "out", "3dtiles", st.StreamOptions(tile_nodes=120, origin=(52.5, 13.4, 34)))
    transform = np.array(manifest_of(tmp_path / "out")["root"]["transform"]).reshape(4, 4).T
    np.testing.assert_allclose(transform, ecef_from_enu(52.5, 13.4, 34))
    with pytest.raises(st.InputError, match="wanted latitude −90 to 90"):
        stream(scene, tmp_path / "out", "3dtiles", st.StreamOptions(origin=(95, 0, 0)), force=True)


def test_cesium_refines_what_looks_too_coarse(scene, folder):
    tiles = open_tileset(folder)
    far = st.Camera.look_at([0.5, 0.5, -1e5], [0.5, 0.5, 0.5])
    assert select_cesium(tiles, far).drawn.tolist() == [0]
    middle = tiles.boxes[0].mean(axis=0)
    inside = st.Camera.look_at(middle, middle + [0, 0, 1])
    chosen = select_cesium(tiles, inside)
    assert len(chosen.drawn) > 1 and set(chosen.drawn) <= set(chosen.loaded)
    assert 0 in chosen.loaded and 0 not in chosen.drawn
    opened = set(tiles.parents[chosen.drawn].tolist()) - {-1}
    assert {int(tile) for tile in np.flatnonzero(np.isin(tiles.parents, list(opened)))} <= set(chosen.loaded.tolist())
    every = select_cesium(tiles, st.Camera.look_at(middle - [0, 0, 50], middle), most_px=0)
    is_leaf = np.ones(len(tiles.names), bool)
    is_leaf[tiles.parents[1:]] = False
    assert np.array_equal(every.drawn, np.flatnonzero(is_leaf))
    corner = tiles.boxes[0, 0]
    aside = select_cesium(tiles, st.Camera.look_at(corner - [0, 0, 0.1], corner + [-0.2, 0, 1]), most_px=1)
    assert len(aside.drawn) and not np.isin(aside.loaded[~np.isin(aside.loaded, aside.drawn)], tiles.parents).all()
    away = st.Camera.look_at(middle - [0, 0, 50], middle - [0, 0, 100])
    assert len(select_cesium(tiles, away).drawn) == 0
