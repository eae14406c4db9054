import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree.kernels.cpu.codec import nodes as cpu
from splatree.kernels.cpu.codec import slots as cpu_slots
from splatree.kernels.reference import nodes as reference
from splatree.kernels.reference import slots as reference_slots
from splatree.maths.harmonics import colors_from_harmonics
from splatree.maths.rotations import matrices_from_quats
from splatree.render.build import build_lod
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene

EYE, CENTRE = np.array([0.3, -0.2, -5.0]), np.array([0.1, 0.2, 0.3])


def random_scene(degree, seed=7, n=1000):
    rng = np.random.default_rng(seed)
    columns = (
        rng.normal(0, 1, (n, 3)),
        rng.normal(0, 10.0 ** rng.uniform(-8, 8), (n, 4)),
        rng.normal(-3, 4, (n, 3)),
        rng.normal(0, 5, n),
        rng.normal(0, 0.6, (n, (degree + 1) ** 2, 3)),
    )
    return build_lod(Scene.flat(Gaussians(*(column.astype(np.float32) for column in columns))))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_node_keeps_what_is_drawn(degree):
    scene = random_scene(degree)
    rows = np.arange(0, len(scene), 3, dtype=np.int32)
    g = scene.gaussians.take(rows)
    found = reference.unpack_nodes(reference.pack_nodes(scene.gaussians, scene.tree, rows, EYE, CENTRE))
    np.testing.assert_allclose(found["means"], g.means - CENTRE, atol=1e-6)
    turned = matrices_from_quats(found["quats"])
    np.testing.assert_allclose(turned, matrices_from_quats(g.quats), atol=2e-4)  # 16 bits: a step of 4e-5 a component
    expected = np.clip(g.log_scales, -reference.LOG_SCALE_MAX, reference.LOG_SCALE_MAX)
    np.testing.assert_allclose(found["log_scales"], expected, atol=reference.LOG_SCALE_MAX / 65535 + 1e-6)
    np.testing.assert_allclose(found["opacities"], 1 / (1 + np.exp(-g.logit_opacities.astype(float))), atol=1e-5)
    directions = g.means - EYE
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = colors_from_harmonics(g.sh, directions, degree)
    np.testing.assert_allclose(
        found["colors"], np.minimum(colors, 2), atol=1.1e-3
    )  # half a step of the 10 bits of blue
    np.testing.assert_array_equal(found["is_leaf"], scene.tree.is_leaf[rows])
    np.testing.assert_array_equal(found["depth"], scene.tree.depth[rows])


@given(degree=st.integers(0, 3), seed=st.integers(0, 1000))
def test_native_nodes_are_those_of_the_definition(degree, seed):
    scene = random_scene(degree, seed, n=200)
    rows = np.arange(len(scene), dtype=np.int32)
    found = reference.unpack_nodes(cpu.pack_nodes(scene.gaussians, scene.tree, rows, EYE, CENTRE))
    expected = reference.unpack_nodes(reference.pack_nodes(scene.gaussians, scene.tree, rows, EYE, CENTRE))
    steps = {"means": 0, "log_scales": 40 / 65535, "opacities": 1 / 65535, "colors": 2 / 1023, "depth": 0, "is_leaf": 0}
    for name, step in steps.items():  # at a half of a step the rounding may fall either way
        difference = np.abs(found[name].astype(float) - expected[name])
        assert difference.max() <= 1.01 * step, name
        assert (difference > 0).mean() < 0.02, name
    # Two components of nearly one size: either may be left out, and q or −q be kept.
    same = np.abs((found["quats"] * expected["quats"]).sum(axis=1))
    np.testing.assert_allclose(same, 1, atol=1e-8)


@given(degree=st.integers(0, 3))
def test_colours_alone_are_those_of_the_nodes(degree):
    scene = random_scene(degree)
    rows = np.arange(0, 500, 2, dtype=np.int32)
    for kernels in (cpu, reference):
        nodes = kernels.pack_nodes(scene.gaussians, scene.tree, rows, EYE, CENTRE)
        np.testing.assert_array_equal(kernels.pack_colors(scene.gaussians, rows, EYE), nodes[:, 4])


def test_no_rows_are_no_words():
    scene = random_scene(0)
    for kernels in (cpu, reference):
        assert kernels.pack_nodes(scene.gaussians, scene.tree, np.zeros(0, np.int32), EYE, CENTRE).shape == (0, 8)


@given(seed=st.integers(0, 1000))
def test_native_nodes_follow_the_pixel_as_defined(seed):
    scene = random_scene(0, seed, n=200)
    assert scene.tree.curves is not None
    rows = np.arange(len(scene), dtype=np.int32)[::-1].copy()
    dilations = np.random.default_rng(seed).uniform(0, 2, len(rows)).astype(np.float32) * scene.tree.curves[rows, 3]
    words = [
        kernels.pack_nodes(scene.gaussians, scene.tree, rows, EYE, CENTRE, dilations) for kernels in (cpu, reference)
    ]
    found, expected = (reference.unpack_nodes(each) for each in words)
    for kernels, nodes in zip((cpu, reference), words, strict=True):
        shapes = kernels.pack_shapes(scene.gaussians, scene.tree, rows, dilations).view(np.uint16)
        halves = nodes.view(np.uint16)
        np.testing.assert_array_equal(shapes, halves[:, [7, 13, 14, 15]])  # opacity and three scales
    merged = scene.tree.curves[rows, 2] > 0
    stored = reference.unpack_nodes(reference.pack_nodes(scene.gaussians, scene.tree, rows, EYE, CENTRE))
    assert (np.abs(expected["opacities"] - stored["opacities"])[merged] > 1e-3).any()
    np.testing.assert_array_equal(expected["opacities"][~merged], stored["opacities"][~merged])
    # Float32 and float64: variances are differences, which leaves 1 % of the scale of a flat axis.
    np.testing.assert_allclose(found["opacities"], expected["opacities"], atol=2e-4)
    widest = expected["log_scales"].max(axis=1, keepdims=True)
    is_thick = expected["log_scales"] > widest - 5
    np.testing.assert_allclose(found["log_scales"][is_thick], expected["log_scales"][is_thick], atol=0.01)


@given(seed=st.integers(0, 2**32 - 1), first=st.integers(0, 69), limit=st.integers(1, 80))
def test_native_slots_are_those_of_the_definition(seed, first, limit):
    rng = np.random.default_rng(seed)
    n, capacity = 300, 128
    held = np.sort(rng.choice(n, 90, replace=False)).astype(np.int32)
    slots = rng.permutation(capacity)[:90].astype(np.int32)
    slot_after = np.zeros(n, np.int32)
    slot_after[held] = slots + 1
    stamps = rng.integers(0, 5, capacity).astype(np.int32)
    rows = np.sort(rng.choice(n, 70, replace=False)).astype(np.int32)
    means = rng.normal(0, 3, (capacity, 3)).astype(np.float32)
    eyes = rng.normal(0, 0.5, (capacity, 3)).astype(np.float32)
    limits, sent = rng.uniform(0, 2, (2, capacity)).astype(np.float32)
    depths = np.append(rng.normal(size=3), 4.0), 0.05
    results = []
    for kernels in (cpu_slots, reference_slots):
        after, marks = slot_after.copy(), stamps.copy()
        kept, new = kernels.keep(rows, after, marks, 9)
        gone = kernels.release(held, slots, after, marks, 9)
        found, more = kernels.stale(slots, means, eyes, (EYE, CENTRE, 1.0), first, limit)
        drifted, now = kernels.drifted(slots, means, limits, sent, depths, 1.15)
        results.append((kept, new, gone, found, np.array(more), drifted, now, after, marks))
    for found, expected in zip(*results, strict=True):
        np.testing.assert_array_equal(found, expected)
    kept, new, gone, *_ = results[0]
    assert set(rows[new]) == set(rows) - set(held)
    assert set(kept[kept >= 0]) == set(slots) - set(gone)


def test_slots_are_looked_through_from_a_place_on():
    # All have been left behind: those from the place on come first, then those before it.
    slots = np.arange(5, dtype=np.int32)
    means, eyes = np.zeros((5, 3), np.float32), np.full((5, 3), 9, np.float32)
    for kernels in (cpu_slots, reference_slots):
        found, more = kernels.stale(slots, means, eyes, (EYE, CENTRE, 0.1), 3, 4)
        assert (found.tolist(), more) == ([3, 4, 0, 1], True)


def test_a_node_has_drifted_at_a_factor_either_way_and_a_leaf_never():
    means = np.float32([[0, 0, 1], [0, 0, 2], [0, 0, 4], [0, 0, 2]])
    limits, sent = np.float32([9, 9, 9, 0]), np.float32([4, 4, 4, 0])
    depths = np.array([0.0, 0.0, 1.0, 0.0]), 1.0  # dilations of 1, 4, 9 (held by the limit) and 0
    for kernels in (cpu_slots, reference_slots):
        places, now = kernels.drifted(np.arange(4, dtype=np.int32), means, limits, sent, depths, 2.0)
        assert (places.tolist(), now.tolist()) == ([0, 2], [1, 9])
