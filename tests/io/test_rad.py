import json
from dataclasses import replace

import numpy as np
import pytest

import splatree
from splatree import FormatError, InputError, Scene, WriteOptions
from splatree.constants import SH_C0
from splatree.io.formats.rad.container import open_rad, values_of
from splatree.io.formats.rad.nodes import log_sizes
from splatree.io.formats.rad.properties import decode, encode_rotations
from splatree.maths.rotations import matrices_from_quats

from ..scenes import random_gaussians
from .conftest import same_bits
from .rad_files import chunk, deflated, write_rad
from .test_hier import DEPTHS, forest, sigmoid


def angles(a, b):
    """Degrees between rotations."""
    turn = matrices_from_quats(a) @ np.swapaxes(matrices_from_quats(b), 1, 2)
    return np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))


@pytest.mark.parametrize("name", DEPTHS)
@pytest.mark.parametrize("compression", [0, 1, 2])
def test_the_tree_is_kept_and_values_within_their_quantum(tmp_path, name, compression):
    scene = forest(DEPTHS[name], 3 if name == "several roots" else 1)
    splatree.write(scene, tmp_path / "a.rad", options=WriteOptions(compression=compression))
    back = splatree.read(tmp_path / "a.rad")
    assert same_bits(scene.tree.subtree_end, back.tree.subtree_end) and same_bits(scene.tree.depth, back.tree.depth)
    g, b = scene.gaussians, back.gaussians
    assert same_bits(g.means, b.means)
    half = {"rtol": 2**-11, "atol": 2**-25}
    assert np.abs(sigmoid(g.logit_opacities) - sigmoid(b.logit_opacities)).max() <= (
        1e-6 if compression == 0 else 2**-12
    )
    if compression == 0:
        assert same_bits(g.sh[:, 1:], b.sh[:, 1:])
        np.testing.assert_allclose(b.sh[:, 0], g.sh[:, 0], atol=1e-6)  # to a colour and back
        np.testing.assert_allclose(b.log_scales, g.log_scales, atol=2e-6)
    elif compression == 1:
        np.testing.assert_allclose(b.sh[:, 1:], g.sh[:, 1:], **half)
        np.testing.assert_allclose(0.5 + SH_C0 * b.sh[:, 0], 0.5 + SH_C0 * g.sh[:, 0], rtol=2**-11, atol=1e-6)
        np.testing.assert_allclose(b.log_scales, g.log_scales, **half)
    else:  # half a step of the range that the chunk's header says
        found = open_rad(tmp_path / "a.rad").chunks[0].properties
        half_step = {name: (p["max"] - p["min"]) / 2 + 1e-5 for name, p in found.items() if "max" in p}
        assert np.abs(b.log_scales - g.log_scales).max() <= half_step["scales"] / 254
        assert np.abs(b.sh[:, 0] - g.sh[:, 0]).max() * SH_C0 <= half_step["rgb"] / 255
        for order in range(1, g.sh_degree + 1):
            rows = slice(order * order, (order + 1) ** 2)
            assert np.abs(b.sh[:, rows] - g.sh[:, rows]).max() <= half_step[f"sh{order}"] / 254
    # 8 bits of an octahedron and 255 steps of 180 degrees; else w = √(1 − x² − y² − z²), √(2 · 2^-24) rad where it is 0.
    assert angles(g.quats, b.quats).max() <= (1.3 if compression == 2 else 0.05)


def test_degree_mode_and_threshold_are_kept(tmp_path):
    for degree in range(4):
        scene = replace(Scene.flat(random_gaussians(5, degree), mode="antialiased"), threshold=0.013)
        lost = splatree.write(scene, tmp_path / f"{degree}.rad")
        back = splatree.read(tmp_path / f"{degree}.rad")
        assert (back.gaussians.sh_degree, back.mode, back.threshold) == (degree, "antialiased", 0.013)
        assert lost == ("precision: rad rounds values to steps of its own",)


def test_values_are_checked(tmp_path):
    centres = np.zeros((3, 5), "<f4")
    centres[1, 3] = np.nan
    path = write_rad(
        tmp_path / "a.rad", [chunk(minimal(center=made("center", "f32", centres.tobytes())), count=5)], count=5
    )
    with pytest.raises(FormatError, match=r"row 3, means\[1\]: found nan"):
        splatree.read(path)
    scene = splatree.read(path, repair=True)
    assert len(scene) == 4 and scene.source.metadata["repairs"] == '{"dropped_rows": 1}'


def test_chunks_hold_65536_nodes_and_the_largest_families_first(tmp_path):
    """Two chunks: the joined root, all roots, then the leaves of each root, those of larger roots before."""
    depth = np.array([0, 1, 1] * 30_001, np.uint8)
    g = random_gaussians(len(depth), 0)
    end = np.arange(1, len(depth) + 1, dtype=np.int32)
    end[::3] += 2
    scene = Scene(g, splatree.GaussianTree(end, depth, np.ones(len(depth), np.float32)))
    splatree.write(scene, tmp_path / "a.rad", options=WriteOptions(compression=0))
    file = open_rad(tmp_path / "a.rad")
    assert [c.count for c in file.chunks] == [65536, 90_004 - 65536]
    centres = np.concatenate([values_of(c, "center") for c in file.chunks])
    roots = np.arange(0, 90_003, 3)
    assert same_bits(centres[1:30_002], g.means[roots])
    largest = roots[np.argsort(-log_sizes(g)[roots], kind="stable")]
    num_families = (65536 - 30_002) // 2
    first = np.stack([largest + 1, largest + 2], axis=1)[:num_families].ravel()
    assert same_bits(centres[30_002:65536], g.means[first])
    back = splatree.read(tmp_path / "a.rad")
    assert same_bits(back.gaussians.means, g.means) and same_bits(back.tree.subtree_end, end)


def test_rotations_are_close_everywhere():
    rng = np.random.default_rng(0)
    quats = rng.standard_normal((20_000, 4)).astype(np.float32)
    quats[:4] = np.eye(4)
    quats[4:8] = -np.eye(4)
    quats[8:200, 1:] *= 1e-4  # small angles
    data = encode_rotations(quats)
    back = decode("orientation", "oct88r8", data, len(quats), {}, "")
    found = angles(quats, back)
    # The diagonal of a cell of the grid, 2/255 across, is 0.9 degrees where the octahedron's faces are stretched most.
    assert found.max() < 1.3 and np.median(found) < 0.6


FIVE = 5


def made(name, encoding, data, **entry):
    return ({"property": name, "encoding": encoding, **entry}, data)


def minimal(**changes):
    """Properties of a chunk of five Gaussians without harmonics, by simple encodings."""
    properties = {
        "center": made("center", "f32", np.arange(15, dtype="<f4").tobytes()),
        "alpha": made("alpha", "f32", np.full(5, 0.5, "<f4").tobytes()),
        "rgb": made("rgb", "f32", np.full(15, 0.5, "<f4").tobytes()),
        "scales": made("scales", "f32", np.ones(15, "<f4").tobytes()),
        "orientation": made("orientation", "f32", np.zeros(15, "<f4").tobytes()),
    }
    return [value for value in (properties | changes).values() if value is not None]


def read_values(tmp_path, name, data, encoding, **entry):
    file = write_rad(
        tmp_path / "a.rad",
        [chunk(minimal(**{name: made(name, encoding, data, **entry)}), count=FIVE)],
        count=FIVE,
        maxSh=3 if name.startswith("sh") else 0,
    )
    return values_of(open_rad(file).chunks[0], name)


PLANES = np.arange(15, dtype=np.uint8).reshape(3, 5)
"""Codes of three values of five rows, as they lie in the file."""


@pytest.mark.parametrize("encoding", ["f32", "f16", "f32_lebytes", "f16_lebytes"])
def test_float_encodings_are_planar(tmp_path, encoding):
    values = np.linspace(-3, 9, 15, dtype=np.float16).reshape(3, 5)
    raw = values.astype("<f4" if encoding[1:3] == "32" else "<f2")
    data = raw.tobytes()
    if encoding.endswith("lebytes"):
        data = raw.view(np.uint8).reshape(15, -1).T.tobytes()
    np.testing.assert_array_equal(read_values(tmp_path, "center", data, encoding), values.T)


@pytest.mark.parametrize("delta", [False, True])
def test_8_bit_encodings(tmp_path, delta):
    codes = (PLANES.astype(int) * 17 % 256).astype(np.uint8)
    stored = np.diff(codes, axis=1, prepend=np.zeros((3, 1), np.uint8)) if delta else codes
    encoding = "r8_delta" if delta else "r8"
    found = read_values(tmp_path, "rgb", stored.tobytes(), encoding, min=-1.0, max=2.0)
    np.testing.assert_allclose(found, -1 + 3 * (codes.T / 255), atol=1e-6)

    codes = (np.arange(45).reshape(9, 5) * 5 + 100).astype(np.uint8)
    stored = np.diff(codes, axis=1, prepend=np.zeros((9, 1), np.uint8)) if delta else codes
    encoding = "s8_delta" if delta else "s8"
    found = read_values(tmp_path, "sh1", stored.tobytes(), encoding, min=-2.0, max=2.0)
    np.testing.assert_allclose(found, codes.T.view(np.int8) / 127 * 2, atol=1e-6)


def test_logarithmic_encodings(tmp_path):
    codes = np.array([[0, 1, 2, 128, 255]] * 3, np.uint8)
    found = read_values(tmp_path, "scales", codes.tobytes(), "ln_0r8", min=-10.0, max=2.7)
    np.testing.assert_allclose(found[:, 0], [-30, -10, -10 + 0.05, -10 + 0.05 * 127, 2.7], atol=1e-5)
    halves = np.linspace(-9, 4, 15, dtype="<f2").reshape(3, 5)
    np.testing.assert_array_equal(read_values(tmp_path, "scales", halves.tobytes(), "ln_f16"), halves.T)


def test_octahedral_axes(tmp_path):
    """Codes 255 and 0 are exact ends; the middle lies between 127 and 128."""
    codes = np.array([[255, 127, 255], [127, 255, 255], [0, 127, 255], [0, 0, 255], [255, 127, 0]], np.uint8)
    w, *axis = read_values(tmp_path, "orientation", codes.tobytes(), "oct88r8").T
    np.testing.assert_allclose(w, [0, 0, 0, 0, 1], atol=1e-6)
    wanted = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, -1], [0, 0, 0]])
    np.testing.assert_allclose(np.array(axis).T, wanted, atol=0.01)


def test_a_palette_of_harmonics(tmp_path):
    entries = np.arange(18, dtype="<f4").reshape(2, 9)  # two entries of degree 1
    labels = np.array([1, 0, 0, 1, 1], "<u2")
    properties = [
        *minimal(),
        made("sh1_code", "f32", entries.T.tobytes()),
        made("sh_label", "u16", labels.tobytes()),
    ]
    path = write_rad(tmp_path / "a.rad", [chunk(properties, count=5)], count=5, maxSh=1, shCodeCount=2)
    np.testing.assert_array_equal(splatree.read(path).gaussians.sh[:, 1:].reshape(5, 9), entries[labels])

    properties[-1] = made("sh_label", "u16", (labels + 1).astype("<u2").tobytes())
    path = write_rad(tmp_path / "a.rad", [chunk(properties, count=5)], count=5, maxSh=1, shCodeCount=2)
    with pytest.raises(FormatError, match="sh_label: found 2, wanted less than the 2 entries"):
        splatree.read(path)


def test_opacities_above_one_become_wider_and_are_counted(tmp_path):
    """a = 1.25 is D = 2, A = e^(3/e) = 3.0155, about H_3 = 11/6."""
    links = [made("child_count", "u16", np.array([4, 0, 0, 0, 0], "<u2").tobytes())]
    links.append(made("child_start", "u32", np.array([1, 0, 0, 0, 0], "<u4").tobytes()))
    alphas = made("alpha", "f16", np.array([1.25, 1, 0.5, 0, 0.25], "<f2").tobytes())
    path = write_rad(tmp_path / "a.rad", [chunk(minimal(alpha=alphas) + links, count=5)], count=5, lodTree=True)
    scene = splatree.read(path)
    assert scene.source.metadata["opacities_above_one"] == '{"read_as_wider": 1}'
    opacities = sigmoid(scene.gaussians.logit_opacities)
    np.testing.assert_allclose(opacities, [0.999, 1 - 2**-12, 0.5, 2**-25, 0.25], rtol=1e-5)
    np.testing.assert_allclose(np.exp(2 * scene.gaussians.log_scales[:, 0]), [1.8377, 1, 1, 1, 1], atol=1e-3)


def test_chunks_may_lie_in_files_beside_it(tmp_path):
    first, second = (chunk(minimal(), count=5, base=base) for base in (0, 5))
    path = write_rad(tmp_path / "a.rad", [first], count=10)
    (tmp_path / "a-1.radc").write_bytes(second)
    data = path.read_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[4:8], "little")])
    for name in ("a-1.radc", "../a-1.radc", "/a-1.radc", "gone.radc"):
        header["chunks"][1:] = [{"offset": 0, "bytes": len(second), "filename": name}]
        text = json.dumps(header).encode().ljust(1000)
        path.write_bytes(b"RAD0" + len(text).to_bytes(4, "little") + text + first)
        if name == "a-1.radc":
            assert len(splatree.read(path)) == 10
        else:
            with pytest.raises(FormatError, match=r"relative path inside the folder|cannot be read"):
                splatree.read(path)


def tree_of(first, count):
    return [
        made("child_count", "u16", np.array(count, "<u2").tobytes()),
        made("child_start", "u32", np.array(first, "<u4").tobytes()),
    ]


@pytest.mark.parametrize(
    ("links", "message"),
    [
        (tree_of([1, 0, 0, 0, 0], [4, 0, 1, 0, 0]), "child of two or its own ancestor"),
        (tree_of([2, 1, 0, 0, 0], [3, 1, 0, 0, 0]), "node 1: found no ways"),
        (tree_of([1, 0, 0, 0, 0], [5, 0, 0, 0, 0]), "node 0: found 5 children from node 1, wanted nodes 0 to 4"),
        (tree_of([2**32 - 1, 0, 0, 0, 0], [1, 0, 0, 0, 0]), "from node 4294967295"),
        ([], "found no child_start"),
    ],
)
def test_links_that_are_no_tree_are_refused(tmp_path, links, message):
    path = write_rad(tmp_path / "a.rad", [chunk(minimal() + links, count=5)], count=5, lodTree=True)
    with pytest.raises(FormatError, match=message):
        splatree.read(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"center": made("center", "f32", bytes(61))}, "center: found more than 60 bytes, wanted 60"),
        ({"center": made("center", "f32", bytes(59))}, "center: found 59 bytes, wanted 60 for 5 rows of f32"),
        ({"center": made("center", "f64", bytes(60))}, "encoding 'f64', wanted f32 or f16"),
        ({"center": made("center", "f32", bytes(60), offset=10**6)}, "bytes 1000000 to .* in a payload of"),
        ({"center": made("center", "f32", bytes(60), compression="xz")}, "compression 'xz', wanted 'gz' or none"),
        ({"center": made("center", "f32", bytes(60), bytes=3)}, "center: (cannot be inflated|found)"),
        ({"center": None}, "found no center"),
        ({"rgb": made("rgb", "r8", bytes(15))}, "rgb: found no key 'max'"),
        ({"rgb": made("rgb", "r8", bytes(15), min=0, max="x")}, "rgb.max: found"),
        ({"extra": made("normals", "f32", bytes(60))}, "property 'normals'"),
        ({"extra": made("center", "f32", bytes(60))}, "center: found it twice"),
    ],
)
def test_properties_that_make_no_sense_are_refused(tmp_path, change, message):
    path = write_rad(tmp_path / "a.rad", [chunk(minimal(**change), count=5)], count=5)
    with pytest.raises(FormatError, match=message):
        splatree.read(path)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({"version": 2}, "version 2, wanted version 1"),
        ({"type": "mesh"}, "type 'mesh'"),
        ({"count": 6}, "found 5 Gaussians in its chunks, wanted the 6"),
        ({"maxSh": 4}, "maxSh: found 4"),
        ({"maxSh": 1}, "found no sh1"),
        ({"chunks": 3}, "wanted a list"),
        ({"chunks": [{"offset": 0, "bytes": 10**9}]}, "found bytes .* in a file of"),
        ({"chunks": [{"offset": 1, "bytes": 20}]}, "wanted b'RADC'"),
        ({"splatree": {"mode": "x"}}, "splatree.mode: found 'x'"),
        ({"splatree": {"threshold": 1.5}}, "splatree.threshold: found 1.5"),
    ],
)
def test_headers_that_make_no_sense_are_refused(tmp_path, extra, message):
    path = write_rad(tmp_path / "a.rad", [chunk(minimal(), count=5)], **{"count": 5, **extra})
    with pytest.raises(FormatError, match=message):
        splatree.read(path)


def test_a_chunk_that_is_listed_twice_is_refused(tmp_path):
    data = chunk(minimal(), count=5)
    entry = {"offset": 0, "bytes": len(data)}
    with pytest.raises(FormatError, match="chunk 1: found base 0, wanted 5"):
        splatree.read(write_rad(tmp_path / "a.rad", [data], count=10, chunks=[entry, entry]))


def test_decompression_bombs_are_refused(tmp_path):
    bomb = made("center", "f32", deflated(bytes(10**7)), compression="gz")
    path = write_rad(tmp_path / "a.rad", [chunk(minimal(center=bomb), count=5, compress=False)], count=5)
    with pytest.raises(FormatError, match="center: found more than 60 bytes"):
        splatree.read(path)
    many = chunk(minimal(), count=10**8)
    with pytest.raises(FormatError, match=r"at most 0\.25 a byte"):
        splatree.read(write_rad(tmp_path / "b.rad", [many], count=10**8))


def test_a_cut_off_file_is_refused(tmp_path):
    splatree.write(forest(DEPTHS["one root"], 1), tmp_path / "a.rad")
    whole = (tmp_path / "a.rad").read_bytes()
    for length in (4, 7, 300, 1500, len(whole) - 1):
        (tmp_path / "a.rad").write_bytes(whole[:length])
        with pytest.raises(FormatError, match="cut off"):
            splatree.read(tmp_path / "a.rad")


def test_too_many_children_are_refused(tmp_path):
    depth = np.append(0, np.ones(65536)).astype(np.uint8)
    end = np.arange(1, 65538, dtype=np.int32)
    end[0] = 65537
    scene = Scene(random_gaussians(65537, 0), splatree.GaussianTree(end, depth, np.ones(65537, np.float32)))
    with pytest.raises(InputError, match="a node of 65536 children, wanted at most 65535"):
        splatree.write(scene, tmp_path / "a.rad")


def test_an_empty_scene(tmp_path):
    splatree.write(Scene.flat(random_gaussians(0, 1)), tmp_path / "a.rad")
    assert len(splatree.read(tmp_path / "a.rad")) == 0
