"""Properties of other programs: fused, named under what is lost, or refused; and headers as other tools write them."""

import json

import numpy as np
import pytest

import splatree as st
from splatree import FormatError, InputError
from splatree.io.formats.ply.filter3d import fuse_filter

from ..scenes import random_gaussians
from .conftest import same_bits

NAMES = [f"{n}" for n in ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2")]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]


def save(path, columns, *, elements_before=(), comments=b"", after=b""):
    """A binary file with the columns given by name, each an array whose type is written."""
    kinds = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i1": "char", "i2": "short", "i4": "int"}
    n = len(next(iter(columns.values())))
    head = b"ply\nformat binary_little_endian 1.0\n" + comments
    data = b""
    for text, rows in elements_before:
        head, data = head + text, data + rows
    head += b"element vertex %d\n" % n
    for name, values in columns.items():
        head += f"property {kinds[values.dtype.str[1:]]} {name}\n".encode()
    records = np.zeros(n, [(name, values.dtype.str) for name, values in columns.items()])
    for name, values in columns.items():
        records[name] = values
    path.write_bytes(head + b"end_header\n" + data + records.tobytes() + after)
    return path


def columns_of(g):
    values = [*g.means.T, *g.sh[:, 0].T, g.logit_opacities, *g.log_scales.T, *g.quats.T]
    return {name: np.ascontiguousarray(v, np.float32) for name, v in zip(NAMES, values, strict=True)}


GAUSSIANS = random_gaussians(50, degree=0)


def test_the_3d_filter_is_fused_as_mip_splatting_defines_it(tmp_path):
    filters = np.abs(np.random.default_rng(1).normal(0.02, 0.02, 50)).astype(np.float32)
    filters[:3] = 0
    path = save(tmp_path / "mip.ply", columns_of(GAUSSIANS) | {"filter_3D": filters})
    scene = st.read(path)
    s, f = np.exp(GAUSSIANS.log_scales.astype(np.float64)), filters.astype(np.float64)[:, None]
    wanted = np.sqrt(s**2 + f**2)
    share = np.sqrt((s**2).prod(axis=1) / (wanted**2).prod(axis=1))
    opacity = share / (1 + np.exp(-GAUSSIANS.logit_opacities.astype(np.float64)))
    np.testing.assert_allclose(np.exp(scene.gaussians.log_scales), wanted, rtol=1e-5)
    np.testing.assert_allclose(scene.gaussians.opacities(), opacity, rtol=2e-5)
    assert same_bits(scene.gaussians.log_scales[:3], GAUSSIANS.log_scales[:3])
    assert same_bits(scene.gaussians.logit_opacities[:3], GAUSSIANS.logit_opacities[:3])
    assert scene.mode == "classic" and "--mode antialiased" in json.loads(scene.source.metadata["notes"])[0]
    # The same in chunks, and no filter in what is written.
    done = st.convert(path, tmp_path / "fused.ply")
    assert done.in_chunks and "filter_3D" in done.notes[0] and not done.lost
    again = st.read(tmp_path / "fused.ply")
    assert same_bits(again.gaussians.log_scales, scene.gaussians.log_scales)
    assert same_bits(again.gaussians.logit_opacities, scene.gaussians.logit_opacities)


def test_fusing_holds_for_extreme_filters():
    scales, logits = np.array([[-30.0] * 3, [0.0] * 3, [5.0] * 3], np.float32), np.array([3.0, 3.0, 13.8], np.float32)
    wider, fainter = fuse_filter(scales, logits, np.array([1.0, 1e-8, 1e-3], np.float32))
    np.testing.assert_allclose(wider, [[0.0] * 3, [0.0] * 3, [5.0] * 3], atol=1e-6)
    assert -95 < fainter[0] < -85 and fainter[1] == np.float32(3) and abs(fainter[2] - 13.8) < 1e-3


@pytest.mark.parametrize(
    ("names", "what"),
    [
        (("t", "scale_t", "rot_r_0"), "motion in time"),
        (("trbf_center", "motion_3"), "motion in time"),
        (("velocity_0",), "motion in time"),
        (("beta",), "a kernel that is not a Gaussian"),
        (("scal_shape_0",), "a kernel that is not a Gaussian"),
        (("f_asg_3",), "a network or another basis"),
    ],
)
def test_properties_that_change_the_picture_are_refused_unless_ignored(tmp_path, names, what):
    path = save(tmp_path / "4d.ply", columns_of(GAUSSIANS) | {name: np.ones(50, np.float32) for name in names})
    with pytest.raises(FormatError, match=rf"{what}.*{names[0]}.*picture.*wrong.*--ignore-properties"):
        st.read(path)
    with pytest.raises(FormatError, match=what):
        st.convert(path, tmp_path / "out.ply")
    scene = st.read(path, ignore_properties=True)
    assert same_bits(scene.gaussians.means, GAUSSIANS.means)
    (lost,) = json.loads(scene.source.metadata["lost"])
    assert what in lost and names[0] in lost


def test_features_and_extra_elements_are_named_as_lost(tmp_path):
    columns = columns_of(GAUSSIANS) | {"label": np.ones(50, np.int32), "nx": np.zeros(50, np.float32)}
    before = [(b"element camera 2\nproperty float fov\n", np.zeros(2, np.float32).tobytes())]
    path = save(tmp_path / "a.ply", columns, elements_before=before)
    lost = json.loads(st.read(path).source.metadata["lost"])
    assert lost == [
        "the properties label: splatree does not know them, and draws without them",
        "the elements camera (2 rows): splatree does not know them, and draws without them",
    ]
    assert st.convert(path, tmp_path / "b.ply").lost == tuple(lost)


@pytest.mark.parametrize("rows", [0, 3])
def test_lists_before_the_vertices_are_skipped(tmp_path, rows):
    text = b"element face %d\nproperty uchar flag\nproperty list uchar int vertex_indices\n" % rows
    lists = [b"\1" + bytes([i]) + bytes(4 * i) for i in range(rows)]
    path = save(tmp_path / "a.ply", columns_of(GAUSSIANS), elements_before=[(text, b"".join(lists))])
    assert same_bits(st.read(path).gaussians.means, GAUSSIANS.means)


def test_lists_that_lie_about_their_length_are_refused(tmp_path):
    text = b"element face 3\nproperty list uint int vertex_indices\n"
    path = save(tmp_path / "a.ply", columns_of(GAUSSIANS), elements_before=[(text, b"\xff" * 12)])
    with pytest.raises(FormatError, match=r"cut off|ends within"):
        st.read(path)
    text = b"element face 999999999\nproperty list uchar int vertex_indices\n"
    path = save(tmp_path / "b.ply", columns_of(GAUSSIANS), elements_before=[(text, b"")])
    with pytest.raises(FormatError, match="too few for the 999999999 rows"):
        st.read(path)


def test_faces_may_end_a_file_without_vertices(tmp_path):
    text = b"element face 1\nproperty list uchar int vertex_indices\n"
    columns = {name: values[:0] for name, values in columns_of(GAUSSIANS).items()}
    whole = save(tmp_path / "a.ply", columns, elements_before=[(text, b"\3" + bytes(12))])
    assert len(st.read(whole)) == 0
    (tmp_path / "b.ply").write_bytes(whole.read_bytes()[:-1])
    with pytest.raises(FormatError, match="cut off"):
        st.read(tmp_path / "b.ply")
    (tmp_path / "c.ply").write_bytes(whole.read_bytes()[:-13])  # not even the count of the list
    with pytest.raises(FormatError, match=r"cut off|too few"):
        st.read(tmp_path / "c.ply")


@pytest.mark.parametrize("row", [3, 4999])
def test_a_wrong_row_of_text_is_named_by_its_number(tmp_path, row):
    names = list(columns_of(GAUSSIANS))
    lines = [" ".join("1" * len(names)) for _ in range(5000)]
    lines[row] += " 1"
    head = "".join(f"property float {name}\n" for name in names)
    text = f"ply\nformat ascii 1.0\nelement vertex 5000\n{head}end_header\n" + "\n".join(lines) + "\n"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(FormatError, match=f"vertex {row}: found 15 values, wanted 14"):
        st.read(tmp_path / "a.ply")


def test_comments_in_latin_1_are_kept(tmp_path):
    path = save(tmp_path / "a.ply", columns_of(GAUSSIANS), comments="comment Größe\n".encode("latin-1"))
    assert json.loads(st.read(path).source.metadata["comments"]) == ["Größe"]


@pytest.mark.parametrize("spelling", ["filter_3d", "filter3D", "scalar_filter_3D"])
def test_the_3d_filter_is_known_however_it_is_spelled(tmp_path, spelling):
    filters = np.full(50, 0.05, np.float32)
    wanted = st.read(save(tmp_path / "a.ply", columns_of(GAUSSIANS) | {"filter_3D": filters}))
    found = st.read(save(tmp_path / "b.ply", columns_of(GAUSSIANS) | {spelling: filters}))
    assert same_bits(found.gaussians.log_scales, wanted.gaussians.log_scales)
    assert not same_bits(found.gaussians.log_scales, GAUSSIANS.log_scales)
    assert "lost" not in found.source.metadata


@pytest.mark.parametrize("names", [("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b")])
def test_colours_under_other_names_are_read(tmp_path, names):
    shares = np.linspace(0, 1, 50)
    columns = {name: v for name, v in columns_of(GAUSSIANS).items() if not name.startswith("f_dc")}
    columns |= {name: (255 * shares[::step]).astype(np.uint8) for name, step in zip(names, (1, -1, 1), strict=True)}
    scene = st.read(save(tmp_path / "a.ply", columns))
    colors = 0.5 + st_c0() * scene.gaussians.sh[:, 0]
    np.testing.assert_allclose(colors, np.stack([shares, shares[::-1], shares], axis=1), atol=1 / 255)
    assert "lost" not in scene.source.metadata


def test_colours_that_overshoot_1_are_not_taken_for_bytes(tmp_path):
    columns = {name: v for name, v in columns_of(GAUSSIANS).items() if not name.startswith("f_dc")}
    columns |= {name: np.linspace(0, 1.3, 50, dtype=np.float32) for name in ("red", "green", "blue")}
    scene = st.read(save(tmp_path / "a.ply", columns))
    np.testing.assert_allclose(0.5 + st_c0() * scene.gaussians.sh[:, 0, 0], columns["red"], atol=1e-6)


def test_gaussians_without_colours_are_not_called_a_mesh(tmp_path):
    columns = {name: v for name, v in columns_of(GAUSSIANS).items() if not name.startswith("f_dc")}
    with pytest.raises(FormatError, match=r"Gaussians without colours .*wanted the properties f_dc_0"):
        st.read(save(tmp_path / "a.ply", columns))


@pytest.mark.parametrize("newline", [b"\r\n", b"\r"])
@pytest.mark.parametrize("first", [0x0A, 0x0D, 0x40])
def test_headers_may_end_their_lines_as_other_systems_do(tmp_path, newline, first):
    """The first byte of the data may look like a line's end."""
    columns = columns_of(GAUSSIANS)
    columns["x"][0] = np.frombuffer(bytes([first, 1, 2, 63]), np.float32)[0]
    data = save(tmp_path / "a.ply", columns).read_bytes()
    head, rest = data.split(b"end_header\n", 1)
    (tmp_path / "b.ply").write_bytes(head.replace(b"\n", newline) + b"end_header" + newline + rest)
    assert same_bits(st.read(tmp_path / "b.ply").gaussians.means, st.read(tmp_path / "a.ply").gaussians.means)


@pytest.mark.parametrize("prefix", ["scal_", "scalar_", "scalar_scal_"])
def test_names_as_cloudcompare_writes_them(tmp_path, prefix):
    columns = {name if name in "xyz" else prefix + name: v for name, v in columns_of(GAUSSIANS).items()}
    columns |= {name: np.zeros(50, np.uint8) for name in ("red", "green", "blue")}
    scene = st.read(save(tmp_path / "a.ply", columns))
    assert same_bits(scene.gaussians.quats, GAUSSIANS.quats) and same_bits(scene.gaussians.sh, GAUSSIANS.sh)
    assert "lost" not in scene.source.metadata


@pytest.mark.parametrize(
    ("kind", "largest"), [("u1", 255), ("u2", 65535), ("u2", 255), ("f4", 1), ("f4", 255), ("i4", 255), ("f8", 65535)]
)
def test_colours_of_any_type_are_taken_by_their_range(tmp_path, kind, largest):
    shares = np.linspace(0, 1, 50)
    columns = {name: v for name, v in columns_of(GAUSSIANS).items() if not name.startswith("f_dc")}
    for name in ("red", "green", "blue"):
        columns[name] = (shares * largest).astype(kind)
    scene = st.read(save(tmp_path / "a.ply", columns))
    np.testing.assert_allclose(0.5 + st_c0() * scene.gaussians.sh[:, 0, 0], shares, atol=1 / 255)


def st_c0():
    from splatree.constants import SH_C0

    return SH_C0


def test_what_is_not_a_scene_is_named(tmp_path):
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345678\n"
    page = b"<!DOCTYPE html><html><head><title>404 Not Found</title></head></html>"
    for suffix in ("ply", "spz", "glb", "sog", "splat", "ksplat", "splatree", "rad", "hier", "compressed.ply"):
        for content, message in (
            (b"", "is empty"),
            (pointer, r"Git LFS pointer.*11\.8 MiB.*git lfs pull"),
            (page, "web page"),
        ):
            path = tmp_path / f"a.{suffix}"
            path.write_bytes(content)
            if suffix == "splat" and not content:
                assert len(st.read(path)) == 0  # a scene without Gaussians
                continue
            with pytest.raises(InputError, match=rf"a\.{suffix}: .*{message}"):
                st.read(path)
            with pytest.raises(InputError, match=message):
                st.convert(path, tmp_path / "out.ply")
    (tmp_path / "cameras.json").write_bytes(pointer)
    with pytest.raises(InputError, match="Git LFS pointer"):
        st.read_cameras(tmp_path / "cameras.json")
    (tmp_path / "a.png").write_bytes(pointer)
    with pytest.raises(InputError, match="Git LFS pointer"):
        st.read_image(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("name", "kind"), [("opacity", "uint8"), ("rot_2", "int32"), ("scale_0", "uint16"), ("f_dc_1", "uint8")]
)
def test_codes_of_whole_numbers_are_not_taken_for_values(tmp_path, name, kind):
    """As logits and logarithms they would give a wrong picture; colours of bytes have a meaning, and so have coordinates."""
    columns = columns_of(GAUSSIANS)
    columns[name] = np.arange(len(columns[name])).astype(kind)
    with pytest.raises(st.FormatError, match=f"found {name} as whole numbers"):
        st.read(save(tmp_path / "a.ply", columns))
    columns = columns_of(GAUSSIANS) | {"x": np.arange(len(columns["x"])).astype(np.int32)}
    np.testing.assert_array_equal(st.read(save(tmp_path / "b.ply", columns)).gaussians.means[:, 0], columns["x"])


@pytest.mark.parametrize("kind", ["i1", "i2", "i4"])
def test_colours_below_0_are_refused(tmp_path, kind):
    columns = {name: values for name, values in columns_of(GAUSSIANS).items() if not name.startswith("f_dc")}
    columns |= {name: np.full(50, 100, kind) for name in ("red", "green", "blue")}
    assert len(st.read(save(tmp_path / "a.ply", columns))) == 50
    columns["green"][7] = -56  # 200 as a byte with a sign
    with pytest.raises(FormatError, match="found green of -56 as a whole number with a sign, wanted 0 or more"):
        st.read(save(tmp_path / "b.ply", columns))


def test_a_file_of_another_layout_is_not_called_a_mesh(tmp_path):
    columns = {name: values for name, values in columns_of(GAUSSIANS).items() if not name.startswith("rot_")}
    with pytest.raises(
        FormatError, match=r"no properties rot_0 rot_1 rot_2 rot_3 .*: the file is of another layout, wanted"
    ):
        st.read(save(tmp_path / "a.ply", columns))


def test_bytes_that_miss_behind_the_vertices_are_counted(tmp_path):
    path = save(tmp_path / "a.ply", columns_of(GAUSSIANS))
    data = path.read_bytes().replace(b"end_header", b"element camera 3\nproperty float fov\nend_header")
    path.write_bytes(data + bytes(8))
    with pytest.raises(FormatError, match=r"bytes, 4 fewer than its header announces .*12 bytes behind them"):
        st.read(path)
    scene = st.read(path, repair=True)
    assert len(scene) == 50 and json.loads(scene.source.metadata["repairs"]) == {"missing_bytes": 4}
