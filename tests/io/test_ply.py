import json
import re

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, Scene
from splatree.constants import SH_C0
from splatree.io.formats.ply import format as ply
from splatree.io.options import ReadOptions

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits


def header(names, count, *, kind="float", extra=()):
    lines = ["ply", "format binary_little_endian 1.0", *extra, f"element vertex {count}"]
    return "\n".join([*lines, *(f"property {kind} {name}" for name in names), "end_header", ""]).encode()


NAMES = [
    "x",
    "y",
    "z",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [0, 1, 1500])
def test_round_trip_keeps_every_bit(tmp_path, degree, n):
    gaussians = random_gaussians(n, degree)
    splatree.write(Scene.flat(gaussians), tmp_path / "a.ply")
    back = splatree.read(tmp_path / "a.ply")
    assert all(same_bits(getattr(gaussians, c), getattr(back.gaussians, c)) for c in COLUMNS)
    assert back.source.format == "ply" and back.mode == "classic"


def test_the_real_file_is_written_back_byte_for_byte(tmp_path, data):
    original = data / "formats/semarang_block/block_inria.ply"
    scene = splatree.read(original)
    assert len(scene) == 29_213 and scene.gaussians.sh_degree == 3
    splatree.write(scene, tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_bytes() == original.read_bytes()


def test_antialiased_mode_is_kept(tmp_path):
    splatree.write(Scene.flat(random_gaussians(3), mode="antialiased"), tmp_path / "a.ply")
    assert b"comment SplatRenderMode: mip\n" in (tmp_path / "a.ply").read_bytes()
    assert splatree.read(tmp_path / "a.ply").mode == "antialiased"


@pytest.mark.parametrize("comment", ["antialiased 1", "SPLATRENDERMODE: MIP", "SplatRenderMode: mip"])
def test_modes_of_other_writers_are_understood(tmp_path, comment):
    rows = np.ones((2, len(NAMES)), "<f4")
    (tmp_path / "a.ply").write_bytes(header(NAMES, 2, extra=[f"comment {comment}"]) + rows.tobytes())
    assert splatree.read(tmp_path / "a.ply").mode == "antialiased"


def test_properties_are_found_by_name_in_any_order_and_type(tmp_path):
    rng = np.random.default_rng(1)
    names = [*NAMES, "label", "nx"]
    order = rng.permutation(names).tolist()
    values = rng.standard_normal((7, len(order))).astype("<f4")
    for kind, dtype in (("float", "<f4"), ("double", "<f8"), ("float64", "<f8")):
        (tmp_path / "a.ply").write_bytes(header(order, 7, kind=kind) + values.astype(dtype).tobytes())
        scene = splatree.read(tmp_path / "a.ply")
        g = scene.gaussians
        np.testing.assert_array_equal(g.means, values[:, [order.index(n) for n in ("x", "y", "z")]])
        np.testing.assert_array_equal(g.quats, values[:, [order.index(f"rot_{i}") for i in range(4)]])
        np.testing.assert_array_equal(g.logit_opacities, values[:, order.index("opacity")])
        assert json.loads(scene.source.metadata["extra_properties"]) == ["label"]


def test_harmonics_are_channel_major_in_the_file(tmp_path):
    names = [*NAMES, *(f"f_rest_{i}" for i in range(9))]
    row = np.ones((1, len(names)), "<f4")
    row[0, -9:] = np.arange(9)
    (tmp_path / "a.ply").write_bytes(header(names, 1) + row.tobytes())
    sh = splatree.read(tmp_path / "a.ply").gaussians.sh[0, 1:]
    np.testing.assert_array_equal(sh, np.arange(9).reshape(3, 3).T)  # red 0 1 2, green 3 4 5, blue 6 7 8


def test_byte_colours_stand_in_for_the_dc(tmp_path):
    names = [n for n in NAMES if not n.startswith("f_dc")]
    fields = [(n, "<f4") for n in names] + [(c, "u1") for c in ("red", "green", "blue")]
    rows = np.ones(1, fields)
    rows["red"], rows["green"], rows["blue"] = 0, 255, 51
    head = header(names, 1).replace(
        b"end_header", b"property uchar red\nproperty uchar green\nproperty uchar blue\nend_header"
    )
    (tmp_path / "a.ply").write_bytes(head + rows.tobytes())
    dc = splatree.read(tmp_path / "a.ply").gaussians.sh[0, 0]
    np.testing.assert_allclose(0.5 + SH_C0 * dc, [0, 1, 0.2], atol=1e-6)  # rounding of float32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b.replace(b"binary_little_endian", b"binary"), "found format 'binary', wanted one of"),
        (lambda b: b.replace(b" scale_", b" skale_"), "no properties scale_0 scale_1 scale_2"),
        (
            lambda b: b.replace(b"element vertex", b"element codebook_centers 256\nelement vertex"),
            "indices into a codebook",
        ),
        (lambda b: b.replace(b"property float nx\n", b"property float f_anchor_feat_0\n"), "anchors of Scaffold-GS"),
        (lambda b: b.replace(b" rot_", b" tor_"), "found no properties rot_0 rot_1"),
        (lambda b: b.replace(b"f_rest_3\n", b"g_rest_3\n"), "found 8 properties f_rest"),
        (lambda b: b.replace(b"f_rest_3\n", b"f_rest_9\n"), "numbered from 0"),
        (lambda b: b.replace(b"f_rest_3\n", b"f_rest_2\n"), "two properties of the same name"),
        (lambda b: b.replace(b"vertex 5", b"vertex 6"), "bytes, wanted .* cut off"),
        (lambda b: b.replace(b"vertex 5", b"vertex 4"), "found 1147 bytes, 104 more than"),
        (lambda b: b.replace(b"vertex 5", b"vertex 999999999999999"), "cut off"),
        (lambda b: b.replace(b"vertex 5", b"vertex -5"), "line 3 of the header"),
        (lambda b: b.replace(b"vertex 5", b"vertices 5"), "wanted one named 'vertex'"),
        (lambda b: b.replace(b"property float x", b"property floot x"), "line 4.*floot"),
        (lambda b: b.replace(b"property float x", b"property list uchar int x"), "hold lists"),
        (lambda b: b.replace(b"end_header", b"edn_header"), "line 27|no end_header"),
        (lambda b: b[:100], "no end_header"),
        (lambda b: b[:-1], "cut off"),
        (lambda b: b + b"\0", "1 more than"),
    ],
)
def test_lying_and_foreign_files_are_refused_with_a_reason(tmp_path, change, message):
    splatree.write(Scene.flat(random_gaussians(5, 1)), tmp_path / "a.ply")
    good = (tmp_path / "a.ply").read_bytes()
    bad = change(good)
    assert bad != good
    (tmp_path / "a.ply").write_bytes(bad)
    with pytest.raises(FormatError, match=message):
        splatree.read(tmp_path / "a.ply")


def text_of(path) -> str:
    """The same vertices as text, behind an element of two cameras, as MeshLab writes them."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    names = re.findall(rb"property float (\S+)", head)
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    lines = [" ".join(repr(float(v)) for v in row) for row in rows]
    text = head.decode().replace("binary_little_endian", "ascii")
    text = text.replace("element vertex", "element camera 2\nproperty float view\nelement vertex")
    return "\n".join([text + "end_header", "7", "8", *lines, ""])


def test_text_and_big_endian_files_give_the_same_bits(tmp_path):
    g = random_gaussians(9, 2)
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    (tmp_path / "text.ply").write_text(text_of(tmp_path / "a.ply"))
    head, mark, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    big = head.replace(b"little", b"big") + mark + np.frombuffer(body, "<f4").astype(">f4").tobytes()
    (tmp_path / "big.ply").write_bytes(big)
    for name in ("text.ply", "big.ply"):
        back = splatree.read(tmp_path / name).gaussians
        assert all(same_bits(getattr(g, c), getattr(back, c)) for c in COLUMNS)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t[: len(t) // 2], "lines of vertices, wanted 9; the file is cut off"),
        (lambda t: t.replace("vertex 9", "vertex 999999999999"), "found 9 lines of vertices, wanted 999999999999"),
        (lambda t: t.replace("vertex 9", "vertex 10"), "found 9 lines of vertices, wanted 10; .* the 9 whole ones"),
        (lambda t: t.replace("vertex 9", "vertex 8"), "found 1 line more than its header announces"),
        (
            lambda t: t.replace("vertex 9", "vertex 8").replace(
                "end_header", "element face 2\nproperty int i\nend_header"
            ),
            "found 1 line less than its header announces",
        ),
        (lambda t: t[: t.rindex(" ")] + " 1,5\n", "vertex 8: found rot_3 '1,5', wanted a number"),
        (lambda t: t[:-1] + "1" * 3_000_000, "found a line of more than"),
        (lambda t: t[: t.rindex(" ")] + "\n", "vertex 8: found 22 values, wanted 23"),
        (lambda t: t[: t.rindex(" ")] + " nan\n", r"row 8, quats: found .*nan"),
        (lambda t: t[: t.rindex(" ")] + " 1e300\n", r"row 8, quats: found .*inf"),
    ],
)
def test_text_that_is_no_table_of_numbers_is_refused(tmp_path, change, message):
    splatree.write(Scene.flat(random_gaussians(9, 1)), tmp_path / "a.ply")
    text = text_of(tmp_path / "a.ply").replace("property float nx\nproperty float ny\nproperty float nz\n", "")
    head, mark, body = text.partition("end_header\n")
    rows = [line.split() for line in body.splitlines()]
    body = "\n".join(" ".join(row[:3] + row[6:]) for row in rows) + "\n"
    (tmp_path / "a.ply").write_text(head + mark + body)
    assert len(splatree.read(tmp_path / "a.ply")) == 9
    (tmp_path / "a.ply").write_text(change(head + mark + body))
    with pytest.raises(FormatError, match=message):
        splatree.read(tmp_path / "a.ply")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\n\n", "\r\r\n", " \n"])
def test_lines_of_text_may_end_in_any_way_and_empty_ones_do_not_count(tmp_path, end):
    g = random_gaussians(5000, 0)
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    (tmp_path / "b.ply").write_bytes(text_of(tmp_path / "a.ply").replace("\n", end).encode())
    back = splatree.read(tmp_path / "b.ply").gaussians
    assert all(same_bits(getattr(g, c), getattr(back, c)) for c in COLUMNS)
    chunks = ply.read_chunks(tmp_path / "b.ply", ReadOptions())
    assert same_bits(np.concatenate([chunk.means.copy() for chunk in chunks]), g.means)


@pytest.mark.parametrize(("kept", "whole"), [(1.0, 9), (0.9999, 8), (0.7, None)])
def test_the_whole_rows_of_a_text_that_was_cut_off_are_read_with_repair(tmp_path, kept, whole):
    g = random_gaussians(9, 1)
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    text = text_of(tmp_path / "a.ply").replace("vertex 9", "vertex 10")
    (tmp_path / "a.ply").write_text(text[: int(len(text) * kept)])
    scene = splatree.read(tmp_path / "a.ply", repair=True)
    assert 0 < len(scene) < 10 and whole in (len(scene), None)
    assert same_bits(scene.gaussians.quats, g.quats[: len(scene)])
    assert json.loads(scene.source.metadata["repairs"]) == {"missing_rows": 10 - len(scene)}


def test_harmonics_of_degree_4_are_cut_and_named(tmp_path):
    names = [*NAMES, *(f"f_rest_{i}" for i in range(72))]
    row = np.ones((2, len(names)), "<f4")
    row[0, -72:] = np.arange(72)
    (tmp_path / "a.ply").write_bytes(header(names, 2) + row.tobytes())
    scene = splatree.read(tmp_path / "a.ply")
    np.testing.assert_array_equal(scene.gaussians.sh[0, 1:], np.arange(72).reshape(3, 24)[:, :15].T)
    assert json.loads(scene.source.metadata["lost"]) == ["the harmonics of degree 4"]
    assert "extra_properties" not in scene.source.metadata


@pytest.mark.parametrize("extra", [[], ["comment SplatRenderMode: 2dgs"]])
def test_surfels_are_read_as_flat_gaussians_and_named(tmp_path, extra):
    names = [name for name in NAMES if name != "scale_2"]
    (tmp_path / "a.ply").write_bytes(header(names, 2, extra=extra) + np.ones((2, len(names)), "<f4").tobytes())
    scene = splatree.read(tmp_path / "a.ply")
    np.testing.assert_allclose(np.exp(scene.gaussians.log_scales), [[np.e, np.e, 1e-6]] * 2, rtol=1e-5)  # float32
    assert "surfels" in scene.source.metadata["lost"]


def chunked(path, repair=False):
    chunks = ply.read_chunks(path, ReadOptions(repair=repair))
    parts = [Gaussians(*(getattr(part, c).copy() for c in COLUMNS)) for part in chunks]
    return chunks, Gaussians.concatenate(parts)


@pytest.mark.parametrize("repair", [False, True, "drop"])
def test_chunks_hold_what_read_gives(tmp_path, monkeypatch, repair):
    monkeypatch.setattr(ply, "ROWS_PER_CHUNK", 100)
    g = random_gaussians(1030, 1)
    g.logit_opacities[[3, 500]] = np.inf, -np.inf
    if repair:
        g.means[::7, 1] = np.nan
        g.quats[5] = 0
    splatree.write(Scene.flat(g, mode="antialiased"), tmp_path / "a.ply")
    chunks, back = chunked(tmp_path / "a.ply", repair)
    whole = ply.read(tmp_path / "a.ply", ReadOptions(repair=repair))
    assert all(same_bits(getattr(whole.gaussians, c), getattr(back, c)) for c in COLUMNS)
    assert chunks.repairs == json.loads(whole.source.metadata["repairs"]) and chunks.mode == "antialiased"
    assert chunks.repairs["clamped_opacities"] == 2
    assert len(chunks) == 1030 - {False: 0, True: 148, "drop": 149}[repair]


def test_an_error_in_a_chunk_names_the_row_of_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(ply, "ROWS_PER_CHUNK", 100)
    g = random_gaussians(1030, 0)
    g.sh[777, 0, 2] = np.inf
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    with pytest.raises(FormatError, match=r"row 777, sh\[0\]\[2\]: found inf"):
        chunked(tmp_path / "a.ply")


@pytest.mark.parametrize("repair", [False, True])
@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply"])
def test_values_whose_line_ends_were_converted_are_refused(tmp_path, name, repair):
    """As a transfer in text mode does: with repair the rows would be read askew."""
    splatree.write(Scene.flat(random_gaussians(200, 1)), tmp_path / name)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes().replace(b"\n", b"\r\n"))
    with pytest.raises(FormatError, match=r"carriage return before each line feed of its binary values, .* as binary"):
        splatree.read(tmp_path / name, repair=repair)


def test_a_truncated_file_is_repaired_to_its_whole_rows(tmp_path):
    gaussians = random_gaussians(5)
    splatree.write(Scene.flat(gaussians), tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes((tmp_path / "a.ply").read_bytes()[:-300])
    scene = splatree.read(tmp_path / "a.ply", repair=True)
    assert json.loads(scene.source.metadata["repairs"]) == {"missing_rows": 2}
    assert same_bits(scene.gaussians.means, gaussians.means[:3].copy())
