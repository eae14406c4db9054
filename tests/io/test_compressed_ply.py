import json

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, Scene
from splatree.io.formats.compressed_ply import format as compressed_ply
from splatree.io.options import ReadOptions

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def in_order_of(a: Gaussians, b: Gaussians) -> Gaussians:
    """The rows of a in the order of b: by their opacities' and colours' codes and, of these, the nearest mean."""
    nearest = [int(np.argmin(((a.means - mean) ** 2).sum(axis=1))) for mean in b.means]
    assert sorted(nearest) == list(range(len(a)))
    return a.take(np.array(nearest))


def angles(a, b):
    qa, qb = (g.quats.astype(np.float64) for g in (a, b))
    qa, qb = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (qa, qb))
    return np.degrees(2 * np.arccos(np.minimum(np.abs((qa * qb).sum(axis=1)), 1)))


def check_steps(a: Gaussians, b: Gaussians):
    """Each field of b is within half a step of that of a; a step is a share of the range of its chunk of 256 rows."""
    a = in_order_of(a, b)
    colors_a, colors_b = (0.5 + 0.28209479 * g.sh[:, 0] for g in (a, b))
    for begin in range(0, len(a), 256):
        rows = slice(begin, begin + 256)
        for x, y, steps in (
            (a.means, b.means, [2047, 1023, 2047]),
            (np.clip(a.log_scales, -20, 20), np.clip(b.log_scales, -20, 20), [2047, 1023, 2047]),
            (colors_a, colors_b, 255),
        ):
            step = np.ptp(x[rows], axis=0) / steps
            # Float32 of the bounds and of the sums adds a few last bits of the largest value.
            assert (np.abs(x[rows] - y[rows]) <= 0.5001 * step + 1e-6 * np.abs(x[rows]).max()).all()
    np.testing.assert_allclose(sigmoid(b.logit_opacities), sigmoid(a.logit_opacities), atol=0.5001 / 255)
    np.testing.assert_allclose(b.sh[:, 1:], np.clip(a.sh[:, 1:], -4, 4), atol=1.001 / 64)  # codes are 1/32 apart
    # Half of √2 / 1023 in each of three components; where all four are ½, the largest is off by the sum of the three: 0.0024 rad
    # of a half angle.
    assert angles(a, b).max() < 0.28


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [1, 256, 300])
def test_every_field_is_within_half_a_step(tmp_path, n, degree):
    g = random_gaussians(n, degree)
    splatree.write(Scene.flat(g), tmp_path / "a.compressed.ply")
    scene = splatree.read(tmp_path / "a.compressed.ply")
    assert scene.source.format == "compressed-ply" and scene.gaussians.sh_degree == degree
    check_steps(g, scene.gaussians)


def test_size_is_sixteen_bytes_and_the_harmonics(tmp_path):
    splatree.write(Scene.flat(random_gaussians(512, 3)), tmp_path / "a.compressed.ply")
    data = (tmp_path / "a.compressed.ply").read_bytes()
    assert len(data) - data.index(b"end_header\n") - 11 == 2 * 72 + 512 * (16 + 45)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_the_mode_is_kept(tmp_path, mode):
    splatree.write(Scene.flat(random_gaussians(3), mode=mode), tmp_path / "a.compressed.ply")
    assert splatree.read(tmp_path / "a.compressed.ply").mode == mode


def test_neighbours_share_a_chunk(tmp_path):
    """Two far clusters in alternating rows are each as precise as if they were alone: the rows are put along a curve."""
    g = random_gaussians(512, 0)
    g.means[::2] += 1e4
    splatree.write(Scene.flat(g), tmp_path / "a.compressed.ply")
    back = splatree.read(tmp_path / "a.compressed.ply").gaussians
    distances = [np.abs(g.means - mean).max(axis=1).min() for mean in back.means]
    assert max(distances) < 0.5 * 100 / 1023 + 1e-3  # each cluster is less than 100 across; 1e4 has steps of 1e-3


def test_chunks_are_the_whole(tmp_path):
    splatree.write(Scene.flat(random_gaussians(700)), tmp_path / "a.compressed.ply")
    whole = splatree.read(tmp_path / "a.compressed.ply").gaussians
    parts = list(compressed_ply.read_chunks(tmp_path / "a.compressed.ply", ReadOptions()))
    assert all(same_bits(getattr(whole, c), getattr(Gaussians.concatenate(parts), c)) for c in COLUMNS)


def test_no_gaussians_make_a_file(tmp_path):
    splatree.write(Scene.flat(Gaussians.empty(1)), tmp_path / "a.compressed.ply")
    assert len(splatree.read(tmp_path / "a.compressed.ply")) == 0


def test_what_is_clamped_is_told(tmp_path):
    g = random_gaussians(50)
    g.log_scales[3, 1] = -25
    g.sh[8:10, 5] = -5
    lost = " ".join(splatree.write(Scene.flat(g), tmp_path / "a.compressed.ply"))
    assert "log-scales beyond ±20: clamped in 1 Gaussian" in lost and "harmonics beyond ±4: clamped in 2" in lost


def test_gaussians_that_a_far_one_moves_are_counted(tmp_path):
    g = random_gaussians(300)
    g.log_scales[:] = -1  # half a step is at most 60 / 2046
    assert not any("places" in line for line in splatree.write(Scene.flat(g), tmp_path / "a.compressed.ply"))
    g.means[7] = 1e6  # the last along the curve, in a chunk of 44 whose steps become 1e6 / 1023
    (line,) = (line for line in splatree.write(Scene.flat(g), tmp_path / "b.compressed.ply") if "places" in line)
    assert "the places of 44 Gaussians: rounded by up to more than their size" in line


def test_older_files_have_colors_from_0_to_1(tmp_path):
    words = np.array([[1 << 21 | 1023 << 11, 0x3FF, 0, 255 << 24 | 51]], "<u4")
    bounds = np.array([[0, 10, 0, 2047, 20, 1, -9, -8, -7, -9, -8, -7]], "<f4")
    names = [f"{end}_{kind}{axis}" for kind in ("", "scale_") for end in ("min", "max") for axis in "xyz"]
    lines = ["ply", "format binary_little_endian 1.0", "element chunk 1", *(f"property float {n}" for n in names)]
    lines += ["element vertex 1", *(f"property uint packed_{n}" for n in ("position", "rotation", "scale", "color"))]
    data = "\n".join([*lines, "end_header", ""]).encode() + bounds.tobytes() + words.tobytes()
    (tmp_path / "old.ply").write_bytes(data)
    scene = splatree.read(tmp_path / "old.ply")
    g = scene.gaussians
    assert scene.source.format == "compressed-ply"
    np.testing.assert_allclose(g.means, [[1, 20, 0]])
    np.testing.assert_allclose(g.log_scales, [[-9, -8, -7]])
    np.testing.assert_allclose(0.5 + 0.28209479 * g.sh[0, 0], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(sigmoid(g.logit_opacities), [0.2], atol=1e-6)
    # Codes 0, 0, 1023 are −√½, −√½, √½: more than a unit quaternion; the largest is then 0.
    np.testing.assert_allclose(g.quats, [[0, -np.sqrt(0.5), -np.sqrt(0.5), np.sqrt(0.5)]], atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"element vertex 300", b"element vertex 900", "found 2 chunks for 900 Gaussians, wanted 4 of 256 each"),
        (b"element sh 300", b"element sh 299", "element 'sh': found 299 rows, wanted 300"),
        (b"property uchar f_rest_8\n", b"", "found 8 properties f_rest"),
        (b"property uchar f_rest_8", b"property short f_rest_8", "found 9 properties f_rest_*"),
        (b"float min_x", b"float mini_x", "element 'chunk': found min_x missing"),
        (b"float min_g", b"float mini_g", "element 'chunk': found min_g missing"),
        (b"float max_b", b"double max_b", "cut off"),
        (b"uint packed_scale", b"float packed_scale", "found packed_scale of type f4, wanted it of type u4"),
        (b"element chunk 2", b"element chunk 2\nproperty list uchar int faces", "found lists"),
        (b"binary_little_endian", b"ascii", "as text, wanted binary"),
        (
            b"property uchar f_rest_8\n",
            b"property uchar f_rest_8\nproperty uchar more\n",
            "bytes, wanted .* it is cut off",
        ),
    ],
)
def test_a_wrong_header_is_named(tmp_path, old, new, message):
    splatree.write(Scene.flat(random_gaussians(300, 1)), tmp_path / "a.compressed.ply")
    data = (tmp_path / "a.compressed.ply").read_bytes()
    assert data.count(old) == 1
    (tmp_path / "bad.ply").write_bytes(data.replace(old, new))
    with pytest.raises(FormatError, match=message.replace("*", ".*") if message.endswith("*") else message):
        splatree.read(tmp_path / "bad.ply")


def test_bytes_behind_are_refused_or_counted(tmp_path):
    splatree.write(Scene.flat(random_gaussians(3)), tmp_path / "a.compressed.ply")
    with (tmp_path / "a.compressed.ply").open("ab") as file:
        file.write(b"more")
    with pytest.raises(FormatError, match="4 more than its header announces"):
        splatree.read(tmp_path / "a.compressed.ply")
    scene = splatree.read(tmp_path / "a.compressed.ply", repair=True)
    assert json.loads(scene.source.metadata["repairs"]) == {"unexpected_bytes": 4}


def test_values_in_a_ply_that_is_not_compressed_are_not_sniffed(tmp_path):
    splatree.write(Scene.flat(random_gaussians(3)), tmp_path / "a.ply")
    assert splatree.read(tmp_path / "a.ply").source.format == "ply"


def test_real_block_is_as_precise_as_the_formats_own_writer(data, tmp_path):
    folder = data / "formats" / "semarang_block"
    splatree.write(splatree.read(folder / "block_inria.ply"), tmp_path / "a.compressed.ply")
    # Means sorted along an axis pair up rank by rank, with errors no larger than those of the Gaussians themselves.
    wanted, ours, theirs = (
        np.sort(splatree.read(path).gaussians.means, axis=0)
        for path in (folder / "block_inria.ply", tmp_path / "a.compressed.ply", folder / "block.compressed.ply")
    )
    assert np.abs(ours - wanted).sum() < 1.1 * np.abs(theirs - wanted).sum()


def test_biker_is_the_same_object_as_in_spz(data):
    """This .spz follows the format's documents: y up and z back, and nothing in it says so."""
    folder = data / "formats"
    packed = splatree.read(folder / "biker.compressed.ply").gaussians
    spz = splatree.read(folder / "biker_v4.spz", axes="RUB").gaussians
    assert len(packed) == len(spz) == 152_746
    for axis in range(3):
        np.testing.assert_allclose(np.sort(packed.means[:, axis]), np.sort(spz.means[:, axis]), atol=0.02)


def test_other_elements_and_properties_are_named_as_lost(tmp_path):
    path = tmp_path / "a.compressed.ply"
    splatree.write(Scene.flat(random_gaussians(5, 0)), path)
    head, _, data = path.read_bytes().partition(b"end_header\n")
    path.write_bytes(head + b"element camera 2\nproperty float fov\nend_header\n" + data + bytes(8))
    lost = json.loads(splatree.read(path).source.metadata["lost"])
    assert lost == ["the elements camera (2 rows): splatree does not know them, and draws without them"]
