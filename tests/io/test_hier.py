from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, GaussianTree, InputError, Scene, WriteOptions
from splatree.io.formats.hier import format as hier
from splatree.maths.forests import subtree_radii

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits

DEPTHS = {
    "one root": [0, 1, 2, 2, 1, 2, 3, 3],
    "several roots": [0, 1, 2, 2, 1, 0, 0, 1, 1],
    "no levels": [0, 0, 0],
    "one Gaussian": [0],
}


def forest(depth, degree=3, seed=0):
    depth = np.array(depth, np.uint8)
    g = random_gaussians(len(depth), degree, seed)
    end = [next((j for j in range(i + 1, len(depth)) if depth[j] <= depth[i]), len(depth)) for i in range(len(depth))]
    if not depth.any():
        return Scene.flat(g)
    extents = subtree_radii(g.means, g.reach(), depth)
    return Scene(g, GaussianTree(np.array(end, np.int32), depth, extents))


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


@pytest.mark.parametrize("name", DEPTHS)
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_float32_keeps_the_tree_and_all_bits_but_those_of_the_logit(tmp_path, name, degree):
    scene = forest(DEPTHS[name], degree)
    splatree.write(scene, tmp_path / "a.hier")
    back = splatree.read(tmp_path / "a.hier")
    for column in ("means", "quats", "log_scales", "sh"):
        assert same_bits(getattr(scene.gaussians, column), getattr(back.gaussians, column))
    # An opacity near 1 has steps of 2^-24, which the logit stretches by 1 / (1 − α).
    a, b = scene.gaussians.logit_opacities, back.gaussians.logit_opacities
    assert (np.abs(a - b) <= 2.0**-24 / (1 - sigmoid(a)) + 2.0**-23 * np.abs(a)).all()
    for field in ("subtree_end", "depth", "extents"):
        assert same_bits(getattr(scene.tree, field), getattr(back.tree, field))


@pytest.mark.parametrize("name", DEPTHS)
def test_half_precision_keeps_the_tree_and_the_quantum(tmp_path, name):
    scene = forest(DEPTHS[name])
    splatree.write(scene, tmp_path / "a.hier", options=WriteOptions(compression=1))
    back = splatree.read(tmp_path / "a.hier")
    g, b = scene.gaussians, back.gaussians
    assert same_bits(g.means, b.means)
    np.testing.assert_allclose(b.quats, g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True), atol=2**-12)
    np.testing.assert_allclose(b.log_scales, g.log_scales, rtol=2**-11)
    np.testing.assert_allclose(b.sh, g.sh, rtol=2**-11, atol=2**-25)
    np.testing.assert_allclose(sigmoid(b.logit_opacities), sigmoid(g.logit_opacities), atol=2**-12)
    assert same_bits(scene.tree.subtree_end, back.tree.subtree_end) and same_bits(scene.tree.depth, back.tree.depth)


@pytest.mark.parametrize("compression", [0, 1])
def test_boxes_hold_every_ellipsoid_below(tmp_path, compression):
    scene = forest(DEPTHS["several roots"])
    splatree.write(scene, tmp_path / "a.hier", options=WriteOptions(compression=compression))
    num_nodes = len(scene) + 1  # one joins the three roots
    dtype = np.dtype("<f2" if compression else "<f4")
    data = (tmp_path / "a.hier").read_bytes()
    boxes = np.frombuffer(data, dtype, num_nodes * 8, len(data) - num_nodes * 8 * dtype.itemsize).reshape(-1, 2, 4)
    nodes = hier._nodes(scene)[0]
    rotations = splatree.maths.rotations.matrices_from_quats(scene.gaussians.quats)
    for node, (low, high) in zip(nodes, boxes.astype(np.float64), strict=True):
        rows = range(node["start"], scene.tree.subtree_end[node["start"]]) if node["parent"] >= 0 else range(len(scene))
        for row in rows:
            axes = 3 * np.exp(scene.gaussians.log_scales[row].astype(np.float64)) * rotations[row]  # a column an axis
            for corner in (scene.gaussians.means[row] + sign * axes.T for sign in (1, -1)):
                assert (low[:3] <= corner).all() and (corner <= high[:3]).all()
        # Corners up to 64 are rounded outwards by at most two of their steps, 2^-18 or 2^-5.
        assert low[3] == high[3] == pytest.approx((high[:3] - low[:3]).max(), abs=2**-16 if compression == 0 else 2**-3)


def record(scene):
    """The arrays of a float32 file, to be changed and written by `assemble`."""
    g, (nodes, copied) = scene.gaussians, hier._nodes(scene)
    rows = np.append(np.arange(len(g)), copied).astype(int)
    opacities = sigmoid(g.logit_opacities[rows]).astype(np.float32)
    return {"g": g.take(rows), "opacities": opacities, "nodes": nodes}


def assemble(path, g, opacities, nodes):
    parts = [np.int32(len(g)), g.means, g.quats, g.log_scales, opacities, g.sh, np.int32(len(nodes)), nodes]
    parts.append(np.zeros((len(nodes), 8), np.float32))
    path.write_bytes(b"".join(np.ascontiguousarray(part).tobytes() for part in parts))
    return path


def test_gaussians_may_stand_in_any_order(tmp_path):
    scene = forest(DEPTHS["several roots"])
    file = record(scene)
    shuffle = np.random.default_rng(0).permutation(len(file["g"]))
    place = np.argsort(shuffle)
    file["nodes"]["start"][1:] = place[file["nodes"]["start"][1:]]
    file["nodes"]["start"][0] = 0
    file["g"], file["opacities"] = file["g"].take(shuffle), file["opacities"][shuffle]
    back = splatree.read(assemble(tmp_path / "a.hier", **file))
    assert same_bits(back.gaussians.means, scene.gaussians.means)
    assert same_bits(back.tree.subtree_end, scene.tree.subtree_end)


def test_opacities_above_one_become_wider_and_are_counted(tmp_path):
    scene = forest(DEPTHS["one root"])
    file = record(scene)
    file["opacities"][[0, 1]] = (2.0, 1.5)
    back = splatree.read(assemble(tmp_path / "a.hier", **file))
    assert back.source.metadata["opacities_above_one"] == '{"read_as_wider": 2}'
    wider = np.sqrt(1 + np.log([2.0, 1.5]))[:, None]
    got = np.exp(back.gaussians.log_scales[:2]) / np.exp(scene.gaussians.log_scales[:2])
    np.testing.assert_allclose(got, np.broadcast_to(wider, (2, 3)), rtol=1e-5)
    assert same_bits(back.gaussians.log_scales[2:], scene.gaussians.log_scales[2:])
    np.testing.assert_allclose(sigmoid(back.gaussians.logit_opacities[:2]), 0.999, rtol=1e-6)


def test_harmonics_that_are_signalling_nan_are_refused_without_a_warning(tmp_path):
    file = record(forest(DEPTHS["one root"]))
    file["g"].sh.view(np.uint32)[2, 1] = 0x7F800001
    with pytest.raises(FormatError, match="row 2"):
        splatree.read(assemble(tmp_path / "a.hier", **file))


def test_a_node_without_a_stand_in_lifts_its_children(tmp_path):
    scene = forest(DEPTHS["one root"])
    file = record(scene)
    file["nodes"]["merged"][1] = 0  # row 1 and its leaves 2 and 3
    back = splatree.read(assemble(tmp_path / "a.hier", **file))
    np.testing.assert_array_equal(back.tree.depth, [0, 1, 1, 1, 2, 3, 3])
    assert same_bits(back.gaussians.means, scene.gaussians.means[[0, 2, 3, 4, 5, 6, 7]])


@pytest.mark.parametrize(
    ("field", "node", "value", "message"),
    [
        ("first_child", 0, 0, "child of two or its own ancestor|several ways"),
        ("first_child", 1, 7, r"node 1: found 2 children from node 7, wanted nodes 0 to 7"),
        ("children", 0, 2**31 - 1, "node 0: found 2147483647 children"),
        ("children", 0, 1, "no ways to it"),
        ("children", 2, -1, "node 2: found -1 children"),
        ("start", 3, 99, "node 3: found a range .*start 99.*wanted Gaussians 0 to 7"),
        ("start", 3, -1, "node 3: found a range"),
        ("leafs", 3, 100, "node 3: found a range"),
        ("leafs", 0, 1, "node 0: found Gaussians of the scene at an inner node"),
        ("merged", 0, -5, "node 0: found a negative count"),
        ("parent", 4, -1, "several|child of two"),
        ("parent", 0, 3, "no ways to it"),
        ("parent", 4, 0, "node 4: found parent 0, wanted 1"),
    ],
)
def test_nodes_that_make_no_sense_are_refused(tmp_path, field, node, value, message):
    file = record(forest(DEPTHS["one root"]))
    file["nodes"][field][node] = value
    with pytest.raises(FormatError, match=message):
        splatree.read(assemble(tmp_path / "a.hier", **file))


def test_gaussians_claimed_by_many_nodes_are_refused(tmp_path):
    file = record(forest(DEPTHS["one root"]))
    leaves = file["nodes"]["leafs"] == 1
    file["nodes"]["start"][leaves], file["nodes"]["leafs"][leaves] = 0, 8
    with pytest.raises(FormatError, match="nodes that own 36 Gaussians, wanted at most the 8"):
        splatree.read(assemble(tmp_path / "a.hier", **file))


def test_values_of_a_tree_are_checked(tmp_path):
    file = record(forest(DEPTHS["one root"]))
    file["g"].means[3, 1] = np.nan
    path = assemble(tmp_path / "a.hier", **file)
    with pytest.raises(FormatError, match=r"row 3, means\[1\]: found nan"):
        splatree.read(path)
    with pytest.raises(FormatError, match="cannot be repaired"):
        splatree.read(path, repair=True)


def test_a_cut_off_file_is_refused(tmp_path):
    splatree.write(forest(DEPTHS["one root"]), tmp_path / "a.hier")
    whole = (tmp_path / "a.hier").read_bytes()
    for length in (0, 3, 100, 1884, 1900, len(whole) - 1):
        (tmp_path / "a.hier").write_bytes(whole[:length])
        with pytest.raises(FormatError, match="cut off"):
            splatree.read(tmp_path / "a.hier")


def test_half_precision_refuses_what_16_bits_cannot_hold(tmp_path):
    half = WriteOptions(compression=1)
    with pytest.raises(InputError, match="node 0: found 32768 leafs, wanted at most 32767"):
        splatree.write(Scene.flat(random_gaussians(32768, 0)), tmp_path / "a.hier", options=half)
    far = random_gaussians(3, 0)
    far.means[1, 2] = 7e4
    with pytest.raises(InputError, match=r"coordinate or side of 7\d{4}"):
        splatree.write(Scene.flat(far), tmp_path / "a.hier", options=half)
    assert list(tmp_path.iterdir()) == []


def test_a_real_tree_gives_the_same_cut(tmp_path):
    """Half a percent of the bundled city: the same tree, the same rows of the cut, and the same picture but for the logits.

    Readers make balls of the extents, which the file has no place for, and draw nodes by their size on the screen.
    """
    whole = splatree.read(Path(splatree.__file__).parent / "data/semarang_5_9.sog")
    leaves = Scene.flat(whole.gaussians.take(np.arange(0, len(whole), 200)))
    scene = splatree.build_lod(
        leaves, splatree.BuildOptions(follow=False)
    )  # the file holds nodes as they are at their level
    splatree.write(scene, tmp_path / "a.hier")
    back = splatree.read(tmp_path / "a.hier")
    balls = subtree_radii(scene.gaussians.means, scene.gaussians.reach(), scene.tree.depth)
    scene = replace(scene, tree=replace(scene.tree, extents=balls, record=back.tree.record), blocks=None)
    for field in ("subtree_end", "depth", "extents"):
        assert same_bits(getattr(scene.tree, field), getattr(back.tree, field))
    assert all(same_bits(getattr(scene.gaussians, c), getattr(back.gaussians, c)) for c in COLUMNS if c[:5] != "logit")
    for camera in splatree.orbit(scene, splatree.PathOptions(views=2, width=240, height=135)):
        a, b = (splatree.render(replace(s, ids=None), camera).image for s in (scene, back))
        # Logits move by 3e-5 at most, alphas by less, so a pixel by a few times as much.
        np.testing.assert_allclose(a, b, atol=1e-3)


def test_an_empty_scene(tmp_path):
    splatree.write(Scene.flat(Gaussians.empty()), tmp_path / "a.hier")
    assert len(splatree.read(tmp_path / "a.hier")) == 0
