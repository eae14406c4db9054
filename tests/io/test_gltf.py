import base64
import gzip
import json
import struct

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, InputError, Scene, WriteOptions
from splatree.constants import SH_C0
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.harmonics import basis_from_directions

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits


def parts(data: bytes) -> tuple[dict, bytes]:
    """The JSON and the binary chunk of a .glb."""
    (size,) = struct.unpack("<I", data[12:16])
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def glb(content: dict, binary: bytes) -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<IIII", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    return b"glTF" + head + text + struct.pack("<II", len(binary), 0x004E4942) + binary


def written(g, path, mode="classic", **options):
    splatree.write(Scene.flat(g, mode=mode), path, options=WriteOptions(**options), force=True)
    return splatree.read(path)


def changed(tmp_path, change, g=None):
    """A file whose JSON was changed."""
    written(g or random_gaussians(40), tmp_path / "a.glb")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    change(content)
    (tmp_path / "b.glb").write_bytes(glb(content, binary))
    return tmp_path / "b.glb"


def primitive(content):
    return content["meshes"][0]["primitives"][0]


def splats(content):
    return primitive(content)["extensions"]["KHR_gaussian_splatting"]


def check_same_picture(a: Gaussians, b: Gaussians):
    """As exact as exp, log and a norm in float32 are."""
    assert same_bits(a.means, b.means) and same_bits(a.sh, b.sh)
    np.testing.assert_allclose(b.log_scales, a.log_scales, atol=2e-6)
    np.testing.assert_allclose(b.logit_opacities, a.logit_opacities, rtol=2e-5, atol=2e-5)
    covariances = [covariances_from_gaussians(g.quats, g.log_scales) for g in (a, b)]
    scale = np.abs(covariances[0]).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(covariances[1] / scale, covariances[0] / scale, atol=1e-5)


@pytest.mark.parametrize("degree", range(4))
def test_a_plain_file_gives_the_same_picture(tmp_path, degree):
    g = random_gaussians(70, degree)
    scene = written(g, tmp_path / "a.glb")
    assert scene.source.format == "gltf"
    check_same_picture(g, scene.gaussians)


def test_the_file_says_what_the_extension_asks(tmp_path):
    g = random_gaussians(9)
    written(g, tmp_path / "a.glb")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    assert content["extensionsUsed"] == ["KHR_gaussian_splatting"] and primitive(content)["mode"] == 0
    assert primitive(content)["extensions"]["KHR_gaussian_splatting"] == {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }
    assert len(primitive(content)["attributes"]) == 5 + 16 and content["buffers"][0]["byteLength"] == len(binary)
    position = content["accessors"][0]
    means = np.frombuffer(binary, "<f4", 27).reshape(9, 3)
    np.testing.assert_array_equal(means, g.means * np.float32([-1, -1, 1]))
    np.testing.assert_array_equal(position["min"], means.min(axis=0))
    np.testing.assert_array_equal(position["max"], means.max(axis=0))
    quats = np.frombuffer(binary, "<f4", 36, content["bufferViews"][2]["byteOffset"]).reshape(9, 4)
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-6)
    colors = np.frombuffer(binary, "u1", 36, content["bufferViews"][1]["byteOffset"]).reshape(9, 4)
    np.testing.assert_allclose(colors[:, :3] / 255, np.clip(0.5 + SH_C0 * g.sh[:, 0], 0, 1), atol=0.501 / 255)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_a_packed_file_holds_the_codes_of_an_spz(tmp_path, version):
    g = random_gaussians(70)
    packed = written(g, tmp_path / "a.glb", packing="spz", format_version=version, sh_bits=8).gaussians
    alone = written(g, tmp_path / "a.spz", format_version=version, axes="RUB", sh_bits=8).gaussians
    assert all(same_bits(getattr(packed, c), getattr(alone, c)) for c in COLUMNS)
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    extension = primitive(content)["extensions"]["KHR_gaussian_splatting"]["extensions"]
    assert extension == {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}
    assert all("bufferView" not in accessor and accessor["count"] == 70 for accessor in content["accessors"])
    assert (binary[:2] == b"\x1f\x8b") == (version < 4)


def test_packing_takes_the_version_that_its_extension_names(tmp_path):
    written(random_gaussians(7), tmp_path / "a.glb", packing="spz")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    head = gzip.decompress(binary[: content["bufferViews"][0]["byteLength"]])[:8]
    assert head == b"NGSP" + struct.pack("<I", 2)


@pytest.mark.parametrize("packing", [None, "spz"])
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_the_mode_is_kept(tmp_path, mode, packing):
    assert written(random_gaussians(3), tmp_path / "a.glb", mode, packing=packing).mode == mode


@pytest.mark.parametrize("packing", [None, "spz"])
def test_no_gaussians_make_a_file(tmp_path, packing):
    assert len(written(Gaussians.empty(1), tmp_path / "a.glb", packing=packing)) == 0


def test_a_gltf_with_its_buffer_beside_or_inside_it_is_the_same(tmp_path):
    g = written(random_gaussians(30), tmp_path / "a.glb").gaussians
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    (tmp_path / "a b.bin").write_bytes(binary)
    for name, uri in (
        ("a", "a%20b.bin"),
        ("b", "data:application/octet-stream;base64," + base64.b64encode(binary).decode()),
    ):
        content["buffers"][0]["uri"] = uri
        (tmp_path / f"{name}.gltf").write_text(json.dumps(content))
        found = splatree.read(tmp_path / f"{name}.gltf").gaussians
        assert all(same_bits(getattr(g, c), getattr(found, c)) for c in COLUMNS)


@pytest.mark.parametrize(
    "uri", ["../secret.bin", "/etc/passwd", "a/../../x.bin", "http://example.org/a.bin", "gone.bin"]
)
def test_buffers_outside_of_the_folder_are_refused(tmp_path, uri):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(bytes(10_000))
    path = changed(tmp_path, lambda content: None)
    content, _ = parts(path.read_bytes())
    content["buffers"][0]["uri"] = uri
    (tmp_path / "in" / "a.gltf").write_text(json.dumps(content))
    with pytest.raises(FormatError, match="buffers\\[0\\]"):
        splatree.read(tmp_path / "in" / "a.gltf")


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "in").mkdir()
    path = changed(tmp_path, lambda content: None)
    content, binary = parts(path.read_bytes())
    (tmp_path / "secret.bin").write_bytes(binary)
    (tmp_path / "in" / "b.bin").symlink_to(tmp_path / "secret.bin")
    content["buffers"][0]["uri"] = "b.bin"
    (tmp_path / "in" / "a.gltf").write_text(json.dumps(content))
    with pytest.raises(FormatError, match="leads out of its folder"):
        splatree.read(tmp_path / "in" / "a.gltf")


def test_nodes_move_turn_and_scale_what_they_show(tmp_path):
    """A quarter turn about glTF's y (up), twice the size, one to the left: parent and child are applied in turn."""

    def move(content):
        content["nodes"] = [
            {"children": [1], "translation": [1, 0, 0]},
            {"mesh": 0, "rotation": [0, np.sqrt(0.5), 0, np.sqrt(0.5)], "scale": [2, 2, 2]},
        ]

    g = random_gaussians(40)
    moved = splatree.read(changed(tmp_path, move, g)).gaussians
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    signs = np.array([-1, -1, 1])
    wanted = ((2 * (g.means * signs) @ turn.T) + [1, 0, 0]) * signs
    np.testing.assert_allclose(moved.means, wanted, atol=1e-5)
    np.testing.assert_allclose(moved.log_scales, g.log_scales + np.log(2), atol=1e-5)
    assert not np.allclose(moved.sh[:, 1:4], g.sh[:, 1:4])


def columns(*rows):
    """The matrix of a node, column by column, with these rows of its linear part."""
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    return {"matrix": matrix.T.ravel().tolist()}


@pytest.mark.parametrize(
    "node, is_exact",
    [
        ({"scale": [-1, 1, 1]}, True),
        ({"scale": [-2, -2, -2]}, True),
        (columns([0, 3, 0], [3, 0, 0], [0, 0, 3]), True),
        ({"scale": [1, 2, 0.5]}, False),
        (columns([1, 0.4, 0], [0, 1, 0], [0, 0, -1]), False),
    ],
    ids=["mirror", "point", "swap", "stretch", "shear"],
)
def test_nodes_mirror_and_stretch_what_they_show(tmp_path, node, is_exact):
    """Σ' = A Σ Aᵀ, and a mirrored Gaussian has in the mirrored direction the colour that it had."""
    g = random_gaussians(40, 3)
    scene = splatree.read(changed(tmp_path, lambda content: content["nodes"][0].update(node), g))
    moved = scene.gaussians
    linear = np.array(node["matrix"]).reshape(4, 4).T[:3, :3] if "matrix" in node else np.diag(node["scale"])
    signs = np.diag([-1.0, -1, 1])
    linear = signs @ linear @ signs
    np.testing.assert_allclose(moved.means, g.means @ linear.T, atol=1e-5)
    # Scales and quaternions are float32: a relative 10⁻⁶ of the largest variance.
    wanted = linear @ covariances_from_gaussians(g.quats, g.log_scales) @ linear.T
    found = covariances_from_gaussians(moved.quats, moved.log_scales)
    assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()
    directions = np.random.default_rng(3).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turned = directions @ linear.T / np.linalg.norm(directions @ linear.T, axis=1, keepdims=True)
    before, after = (
        basis_from_directions(d, 3) @ h.sh.astype(np.float64) for d, h in ((directions, g), (turned, moved))
    )
    lost = json.loads(scene.source.metadata.get("lost", "[]"))
    assert (np.abs(after - before).max() < 1e-5) == is_exact == (not lost)


def test_hidden_nodes_are_not_shown(tmp_path):
    def hide(content):
        hidden = {"KHR_node_visibility": {"visible": False}}
        content["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [9, 0, 0], "extensions": hidden}]
        content["nodes"] += [{"children": [3], "extensions": hidden}, {"mesh": 0}]
        content["scenes"][0]["nodes"] = [0, 1, 2]
        content["extensionsRequired"] = ["KHR_node_visibility"]

    assert same_bits(splatree.read(changed(tmp_path, hide)).gaussians.means, random_gaussians(40).means)
    with pytest.raises(FormatError, match="shows no Gaussians"):
        splatree.read(
            changed(tmp_path, lambda c: c["nodes"][0].update(extensions={"KHR_node_visibility": {"visible": False}}))
        )


@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (lambda c: c.update(animations=[{"channels": [], "samplers": []}]), "the animations"),
        (
            lambda c: c["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}),
            "the copies of EXT_mesh_gpu_instancing",
        ),
        (lambda c: splats(c).update(projection="orthographic"), "the projection 'orthographic'"),
        (lambda c: splats(c).update(sortingMethod="zDepth"), "the sortingMethod 'zDepth'"),
    ],
)
def test_what_changes_the_picture_and_is_not_followed_is_told(tmp_path, change, lost):
    (sentence,) = json.loads(splatree.read(changed(tmp_path, change)).source.metadata["lost"])
    assert sentence.startswith(lost)


def test_a_stretched_thing_without_harmonics_loses_nothing(tmp_path):
    path = changed(tmp_path, lambda content: content["nodes"][0].update(scale=[1, 2, 1]), random_gaussians(5, 0))
    assert "lost" not in splatree.read(path).source.metadata


@pytest.mark.parametrize("scale", [[0, 0, 0], [1, 1, 0], [1, 1, 1e-9], [1e308, 1e308, 1]])
def test_nodes_that_flatten_are_refused(tmp_path, scale):
    path = changed(tmp_path, lambda content: content["nodes"][0].update(scale=scale))
    with pytest.raises(FormatError, match="flattens"):
        splatree.read(path)


def test_a_node_that_is_its_own_child_is_refused(tmp_path):
    path = changed(tmp_path, lambda content: content["nodes"][0].update(children=[0]))
    with pytest.raises(FormatError, match="two parents"):
        splatree.read(path)


def test_all_primitives_with_gaussians_are_one_scene_and_others_are_told(tmp_path):
    def double(content):
        content["meshes"][0]["primitives"] += [primitive(content), {"attributes": {"POSITION": 0}}]

    scene = splatree.read(changed(tmp_path, double))
    assert len(scene) == 80 and json.loads(scene.source.metadata["lost"]) == ["1 primitives without Gaussians"]


def test_drafts_with_logarithms_of_scales_are_known_by_their_signs(tmp_path):
    g = random_gaussians(40)
    written(g, tmp_path / "a.glb")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    start = content["bufferViews"][3]["byteOffset"]
    logs = binary[:start] + g.log_scales.tobytes() + binary[start + g.log_scales.nbytes :]
    (tmp_path / "b.glb").write_bytes(glb(content, logs))
    assert same_bits(splatree.read(tmp_path / "b.glb").gaussians.log_scales, g.log_scales)


def test_integers_and_strides_are_read(tmp_path):
    """Opacities as normalized u2, rotations as normalized i2, both in records of 12 bytes."""
    n = 40
    g = random_gaussians(n)

    def change(content):
        content["bufferViews"] += [{"buffer": 0, "byteOffset": size, "byteLength": 12 * n, "byteStride": 12}]
        view = len(content["bufferViews"]) - 1
        content["accessors"] += [
            {"bufferView": view, "componentType": 5122, "normalized": True, "count": n, "type": "VEC4"},
            {
                "bufferView": view,
                "byteOffset": 8,
                "componentType": 5123,
                "normalized": True,
                "count": n,
                "type": "SCALAR",
            },
        ]
        attributes = primitive(content)["attributes"]
        attributes["KHR_gaussian_splatting:ROTATION"] = len(content["accessors"]) - 2
        attributes["KHR_gaussian_splatting:OPACITY"] = len(content["accessors"]) - 1
        content["buffers"][0]["byteLength"] += 12 * n

    written(g, tmp_path / "a.glb")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    size = len(binary)
    records = np.zeros(n, [("q", "<i2", 4), ("a", "<u2"), ("pad", "<u2")])
    records["q"] = np.rint(np.roll(g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True), -1, axis=1) * 32767)
    records["a"] = np.rint(65535 / (1 + np.exp(-g.logit_opacities.astype(np.float64))))
    change(content)
    (tmp_path / "b.glb").write_bytes(glb(content, binary + records.tobytes()))
    found = splatree.read(tmp_path / "b.glb").gaussians
    wanted = g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True) * [1, -1, -1, 1]
    np.testing.assert_allclose(found.quats, wanted, atol=1.01 / 65534)
    alpha, beta = (1 / (1 + np.exp(-x.logit_opacities.astype(np.float64))) for x in (g, found))
    np.testing.assert_allclose(beta, alpha, atol=0.51 / 65535)


def test_the_fallback_color_serves_where_there_are_no_harmonics(tmp_path):
    def change(content):
        attributes = primitive(content)["attributes"]
        primitive(content)["attributes"] = {k: v for k, v in attributes.items() if "SH_DEGREE" not in k}

    g = random_gaussians(40, 0)
    found = splatree.read(changed(tmp_path, change, g)).gaussians
    wanted = np.clip(0.5 + SH_C0 * g.sh, 0, 1)
    np.testing.assert_allclose(0.5 + SH_C0 * found.sh, wanted, atol=0.51 / 255)


def test_linear_colors_are_refused_or_counted(tmp_path):
    def change(content):
        primitive(content)["extensions"]["KHR_gaussian_splatting"]["colorSpace"] = "lin_rec709_display"

    path = changed(tmp_path, change)
    with pytest.raises(FormatError, match="found colorSpace 'lin_rec709_display'"):
        splatree.read(path)
    assert json.loads(splatree.read(path, repair=True).source.metadata["repairs"]) == {"other_color_space": 1}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["asset"].update(version="1.0"), "found glTF '1.0'"),
        (lambda c: c["accessors"][0].update(count=2**31 - 1), r"accessors\[0\]: found 2147483647 rows of 12 bytes"),
        (lambda c: c["accessors"][0].update(count=39), r"found 40 rows, wanted 39, as many as of POSITION"),
        (
            lambda c: c["accessors"][3].update(byteOffset=2**40),
            r"accessors\[3\]: found 40 rows .* from byte 1099511627776 on",
        ),
        (lambda c: c["accessors"][3].update(bufferView=77), "wanted a whole number from 0 to 20"),
        (lambda c: c["accessors"][3].update(componentType=5124), "found VEC3 of component type 5124"),
        (lambda c: c["accessors"][3].update(type="SCALAR"), "SCALE: found 1 numbers a row, wanted 3"),
        (lambda c: c["accessors"][3].update(sparse={}), "sparse or without a bufferView"),
        (lambda c: c["bufferViews"][2].update(byteOffset=2**50), r"bufferViews\[2\]: found bytes"),
        (lambda c: c["bufferViews"][2].update(byteStride=4), r"accessors\[2\]: found 40 rows of 16 bytes, 4 apart"),
        (lambda c: c["buffers"][0].update(byteLength=2**40), r"buffers\[0\]: found \d+ bytes, wanted 1099511627776"),
        (
            lambda c: primitive(c)["attributes"].pop("KHR_gaussian_splatting:SCALE"),
            "found no key 'KHR_gaussian_splatting:SCALE'",
        ),
        (
            lambda c: primitive(c)["attributes"].pop("KHR_gaussian_splatting:SH_DEGREE_2_COEF_4"),
            "found no key 'KHR_gaussian_splatting:SH_DEGREE_2_COEF_4'",
        ),
        (lambda c: primitive(c).pop("extensions"), "this glTF shows no Gaussians"),
        (lambda c: primitive(c)["extensions"]["KHR_gaussian_splatting"].update(kernel="cube"), "found kernel 'cube'"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, change, message):
    path = changed(tmp_path, change)
    with pytest.raises(FormatError, match=message):
        splatree.read(path)


def test_an_opacity_beyond_1_is_named_by_its_row(tmp_path):
    g = random_gaussians(40)
    written(g, tmp_path / "a.glb")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    view = content["accessors"][primitive(content)["attributes"]["KHR_gaussian_splatting:OPACITY"]]["bufferView"]
    start = content["bufferViews"][view]["byteOffset"] + 4 * 7
    data = binary[:start] + np.array([128, -0.5], "<f4").tobytes() + binary[start + 8 :]  # 128 of 255, not normalized
    (tmp_path / "b.glb").write_bytes(glb(content, data))
    with pytest.raises(
        FormatError, match="row 7: found an opacity of 128, wanted 0 to 1; whole numbers have to be normalized"
    ):
        splatree.read(tmp_path / "b.glb")
    scene = splatree.read(tmp_path / "b.glb", repair=True)
    assert len(scene) == 38 and json.loads(scene.source.metadata["repairs"]) == {"dropped_rows": 2}


def test_an_old_version_is_not_called_cut_off(tmp_path):
    written(random_gaussians(4), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (tmp_path / "b.glb").write_bytes(data[:4] + bytes([1]) + data[5:])
    with pytest.raises(FormatError, match="found version 1 of glTF, wanted 2; write it again"):
        splatree.read(tmp_path / "b.glb")


@pytest.mark.parametrize("share", [0.0005, 0.01, 0.5, 0.999])
def test_a_file_cut_off_anywhere_is_refused(tmp_path, share):
    written(random_gaussians(40), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (tmp_path / "bad.glb").write_bytes(data[: int(share * len(data)) + 4])
    with pytest.raises(InputError):
        splatree.read(tmp_path / "bad.glb")


def test_options_of_spz_need_its_packing(tmp_path):
    with pytest.raises(InputError, match="found the option sh_bits, which is for"):
        written(random_gaussians(3), tmp_path / "a.glb", sh_bits=8)


def test_real_block_is_the_same_picture(data):
    """Its writer turns the axes of each Gaussian by half a turn, which is the same Gaussian with another quaternion."""
    folder = data / "formats" / "semarang_block"
    check_same_picture(*(splatree.read(folder / name).gaussians for name in ("block_inria.ply", "block.glb")))


def test_what_is_written_of_the_real_block_holds_the_same_numbers(data, tmp_path):
    """Positions, scales, opacities, colours and harmonics as the other writer has them."""
    folder = data / "formats" / "semarang_block"
    splatree.write(splatree.read(folder / "block_inria.ply"), tmp_path / "a.glb")
    files = [parts(path.read_bytes()) for path in (tmp_path / "a.glb", folder / "block.glb")]
    for name in primitive(files[0][0])["attributes"]:
        if name == "KHR_gaussian_splatting:ROTATION":
            continue
        arrays = []
        for content, binary in files:
            accessor = content["accessors"][primitive(content)["attributes"][name]]
            view = content["bufferViews"][accessor["bufferView"]]
            dtype = "u1" if accessor["componentType"] == 5121 else "<f4"
            raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
            arrays.append(np.frombuffer(raw, dtype).astype(np.float64))
        np.testing.assert_allclose(*arrays, rtol=1e-6, atol=1e-6 if name != "COLOR_0" else 0, err_msg=name)
