"""Files of many pieces, .glb and 3D Tiles, in chunks: the scene of reading them whole, whatever the chunks."""

import json

import numpy as np
import pytest

import splatree as st
from splatree.io import placing, rows
from splatree.io.formats.glb import reader
from splatree.io.options import ReadOptions
from splatree.io.registry import detect, files_of, stored_bytes
from splatree.io.rows import scene_of
from splatree.outofcore import run

from ..laws.hard_scenes import hard_scene

SCENES = {name: hard_scene(n, "surface", seed, degree=d) for name, n, seed, d in (("a", 300, 1, 2), ("b", 130, 2, 0))}


def glb_of(path, nodes, meshes):
    """A .gltf whose nodes show meshes of packed and plain scenes, each in a .glb of ours beside it, turned into buffers."""
    whole = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes}
    lists = {"buffers": [], "bufferViews": [], "accessors": [], "meshes": []}
    for name, packing in meshes:
        source = path.with_name(f"{name}_{packing}.glb")
        options = st.WriteOptions(packing=packing)
        st.write(st.Scene.flat(SCENES[name]), source, options=options, force=True)
        data = source.read_bytes()
        length = int.from_bytes(data[12:16], "little")
        own = json.loads(data[20 : 20 + length])
        binary = path.with_name(f"{name}_{packing}.bin")
        binary.write_bytes(data[28 + length :])
        first = {key: len(values) for key, values in lists.items()}
        lists["buffers"].append({"uri": binary.name, "byteLength": own["buffers"][0]["byteLength"]})
        lists["bufferViews"] += [{**view, "buffer": first["buffers"]} for view in own["bufferViews"]]
        for accessor in own.get("accessors", []):
            view = {"bufferView": accessor["bufferView"] + first["bufferViews"]} if "bufferView" in accessor else {}
            lists["accessors"].append({**accessor, **view})
        text = json.dumps(own["meshes"][0])
        mesh = json.loads(text)
        for primitive in mesh["primitives"]:
            if packing is None:
                primitive["attributes"] = {k: v + first["accessors"] for k, v in primitive["attributes"].items()}
            else:
                packed = primitive["extensions"]["KHR_gaussian_splatting"]["extensions"]
                for extension in packed.values():
                    extension["bufferView"] += first["bufferViews"]
        lists["meshes"].append(mesh)
        whole["extensionsUsed"] = own["extensionsUsed"]
    path.write_text(json.dumps({**whole, **lists}))
    return path


TURNED = {"rotation": [0, 0.6, 0, 0.8], "scale": [2, 2, 2], "translation": [5e5, 1, -4e6]}


@pytest.fixture(params=["one", "packed", "many", "far", "tiles"])
def path(tmp_path, request):
    """A file or a folder of pieces."""
    if request.param == "one":
        st.write(st.Scene.flat(SCENES["a"]), tmp_path / "in.glb")
        return tmp_path / "in.glb"
    if request.param == "packed":
        st.write(st.Scene.flat(SCENES["a"]), tmp_path / "in.glb", options=st.WriteOptions(packing="spz"))
        return tmp_path / "in.glb"
    meshes = [("a", None), ("b", None), ("a", "spz")]
    if request.param == "many":
        return glb_of(tmp_path / "in.gltf", [{"mesh": 0}, {"mesh": 1}, {"mesh": 2}], meshes)
    nodes = [{"mesh": 0, **TURNED}, {"mesh": 2, "translation": [5e5, 0, -4e6]}, {"mesh": 1, **TURNED}]
    glb_of(tmp_path / "far.gltf", nodes, meshes)
    if request.param == "far":
        return tmp_path / "far.gltf"
    folder = tmp_path / "tiles"
    folder.mkdir()
    for name, g in SCENES.items():
        st.write(st.Scene.flat(g), folder / f"{name}.glb")
    turn = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 2e6, 1e5, 3, 1]
    children = [{"content": {"uri": "a.glb"}, "transform": turn}, {"content": {"uri": "b.glb"}}]
    (folder / "tileset.json").write_text(json.dumps({"asset": {"version": "1.1"}, "root": {"children": children}}))
    return folder


def same(one, other):
    assert one.mode == other.mode and one.source.origin == other.source.origin
    assert one.source.metadata == other.source.metadata
    for name, column in vars(one.gaussians).items():
        assert column.tobytes() == getattr(other.gaussians, name).tobytes(), name


@pytest.mark.parametrize("chunk", [1, 37, 299])
def test_the_chunks_change_nothing(path, tmp_path, monkeypatch, chunk):
    monkeypatch.setattr(placing, "_ROWS_OF_SAMPLE", 50)
    whole = st.read(path)
    assert len(whole) >= 300
    for module in (rows, reader):
        monkeypatch.setattr(module, "ROWS_PER_CHUNK", chunk)
    chunks = detect(path).read_chunks(path, ReadOptions())
    assert (len(chunks), chunks.sh_degree, chunks.origin) == (len(whole), 2, whole.source.origin)
    other = scene_of(detect(path).read_chunks(path, ReadOptions()), "read")
    for _ in range(2):  # as often as a writer likes
        found = scene_of(chunks, "read")
        same(found, other)
    for name, column in vars(whole.gaussians).items():
        assert column.tobytes() == getattr(found.gaussians, name).tobytes(), name


def test_the_origin_is_found_from_the_same_rows_whatever_the_chunks(tmp_path, monkeypatch):
    nodes, samples = [{"mesh": 0, **TURNED}, {"mesh": 1}], []
    path = glb_of(tmp_path / "in.gltf", nodes, [("a", None), ("b", None)])
    monkeypatch.setattr(placing, "_ROWS_OF_SAMPLE", 50)
    monkeypatch.setattr(placing, "origin_of", lambda means, _: (samples.append(means), (0.0, 0.0, 0.0))[1])
    for chunk in (1000, 37, 1):
        monkeypatch.setattr(rows, "ROWS_PER_CHUNK", chunk)
        detect(path).read_chunks(path, ReadOptions())
    assert len(samples[0]) == 55  # every eighth of each piece
    assert samples[0].tobytes() == samples[1].tobytes() == samples[2].tobytes()


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".splatree", ".glb"])
def test_a_conversion_goes_in_chunks(path, tmp_path, suffix):
    done = st.convert(path, tmp_path / f"chunks{suffix}", st.ConvertOptions(edit=st.EditOptions(min_opacity=0.2)))
    assert done.in_chunks and 0 < done.num_written < done.num_read
    edited = st.edit(st.read(path), st.EditOptions(min_opacity=0.2))
    st.write(edited, tmp_path / f"whole{suffix}")
    assert (tmp_path / f"chunks{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


def test_moved_pieces_are_where_their_matrices_put_them(tmp_path):
    nodes = [{"mesh": 0, **TURNED}]
    found = st.read(glb_of(tmp_path / "in.gltf", nodes, [("a", None)]))
    assert any(found.source.origin)
    # Both are turned in the axes of glTF, where x and y have other signs than ours.
    c, s = 1 - 2 * 0.6**2, 2 * 0.6 * 0.8
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    signs = np.diag([-1.0, -1.0, 1.0])
    wanted = 2 * (SCENES["a"].means.astype(np.float64) @ signs) @ turn.T + np.array([5e5, 1, -4e6])
    world = found.gaussians.means.astype(np.float64) + np.asarray(found.source.origin)
    np.testing.assert_allclose(world @ signs, wanted, atol=1e-5)
    np.testing.assert_allclose(found.gaussians.log_scales, SCENES["a"].log_scales + np.log(np.float32(2)), atol=1e-6)


def test_a_bad_value_is_named_by_its_row_in_the_whole_and_repaired_there(tmp_path):
    path = glb_of(tmp_path / "in.gltf", [{"mesh": 1}, {"mesh": 0}], [("a", None), ("b", None)])  # the last node first
    binary = tmp_path / "b_None.bin"
    text = json.loads(path.read_text())
    accessor = text["accessors"][text["meshes"][1]["primitives"][0]["attributes"]["POSITION"]]
    view = text["bufferViews"][accessor["bufferView"]]
    place = view.get("byteOffset", 0) + accessor.get("byteOffset", 0) + 7 * view.get("byteStride", 12)
    data = bytearray(binary.read_bytes())
    data[place : place + 4] = np.float32(np.nan).tobytes()
    binary.write_bytes(data)
    with pytest.raises(st.FormatError, match=r"in\.gltf: row 307, means\[0\]: found nan"):
        st.read(path)
    done = st.convert(path, tmp_path / "out.ply", st.ConvertOptions(read=ReadOptions(repair=True)))
    assert (done.num_written, sum(done.repairs.values())) == (429, 1)
    scene = st.read(path, repair=True)
    assert len(scene) == 429 and json.loads(scene.source.metadata["repairs"]) == done.repairs
    folder = tmp_path / "tiles"
    folder.mkdir()
    for name in ("in.gltf", "a_None.bin", "b_None.bin"):
        (tmp_path / name).rename(folder / name)
    (folder / "tileset.json").write_text('{"asset": {"version": "1.1"}, "root": {"content": {"uri": "in.gltf"}}}')
    tiles = st.convert(folder, tmp_path / "tiles.ply", st.ConvertOptions(read=ReadOptions(repair=True)))
    assert tiles.repairs == done.repairs
    assert (tmp_path / "tiles.ply").read_bytes() == (tmp_path / "out.ply").read_bytes()


def test_buffers_beside_a_file_count_as_its_bytes_and_are_known_again(tmp_path, monkeypatch):
    path = glb_of(tmp_path / "in.gltf", [{"mesh": 0}, {"mesh": 1}], [("a", None), ("b", None)])
    names = ["in.gltf", "a_None.bin", "b_None.bin"]
    assert files_of(path) == [tmp_path / name for name in names]
    assert stored_bytes(path) == sum((tmp_path / name).stat().st_size for name in names)
    tileset = '{"asset": {"version": "1.1"}, "root": {"content": {"uri": "in.gltf"}}}'
    (tmp_path / "tileset.json").write_text(tileset)
    assert files_of(tmp_path) == [tmp_path / name for name in ("tileset.json", *names)]
    monkeypatch.setattr("splatree.io.budget.ROWS_ALWAYS", 100)
    monkeypatch.setattr(
        "splatree.io.formats.tiles3d.format._ROWS_PER_BYTE", 300 / path.stat().st_size
    )  # of the JSON alone
    assert len(st.read(tmp_path / "tileset.json")) == 430
    assert st.check(tmp_path / "tileset.json")[0].num_bytes == stored_bytes(path) + len(tileset)


def test_a_build_begins_anew_if_a_buffer_beside_its_input_has_changed(tmp_path, monkeypatch):
    path = glb_of(tmp_path / "in.gltf", [{"mesh": 0}], [("a", None)])
    monkeypatch.setattr(run, "do_piece", None)
    options, running = st.BuildOptions(method="radius"), st.FolderOptions(part_rows=100)
    plan = tmp_path / "out.splatree.work" / "plan.json"
    with pytest.raises(TypeError):
        st.build_folder(path, tmp_path / "out.splatree", options, running)
    first = json.loads(plan.read_text())["run"]
    (tmp_path / "a_None.bin").touch()
    with pytest.raises(TypeError):
        st.build_folder(path, tmp_path / "out.splatree", options, running)
    assert json.loads(plan.read_text())["run"] != first
