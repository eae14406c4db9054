"""Sketches of cuts: how much of the picture merged nodes are, and how much they leave out (lod/sketch.py)."""

from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.constants import SH_C0
from splatree.lod.sketch import SKETCH_PX, Sketcher, color_variances

from ..scenes import surface

CAMERA = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=240, height=160)


@pytest.fixture(scope="module")
def scene() -> st.Scene:
    return st.build_lod(st.Scene.flat(surface(600)), st.BuildOptions(max_roots=4))


def test_variances_are_those_of_the_leaves_below(scene):
    """By the definition, node by node."""
    g, tree = scene.gaussians, scene.tree
    found = color_variances(scene)
    assert (found[tree.is_leaf] == 0).all()
    inner = np.flatnonzero(~tree.is_leaf)
    assert len(inner) > 50
    for row in inner[::7]:
        leaves = np.arange(row, tree.subtree_end[row])
        leaves = leaves[tree.is_leaf[leaves]]
        weights = g.opacities()[leaves] * np.sort(g.scales()[leaves], axis=1)[:, 1:].prod(axis=1)
        colors = np.maximum(g.sh[leaves, 0] * SH_C0 + 0.5, 0)
        mean = np.average(colors, axis=0, weights=weights)
        wanted = np.average(((colors - mean) ** 2).sum(axis=1), weights=weights)
        assert found[row] == pytest.approx(wanted, rel=1e-4, abs=1e-7)  # float32 of differences of running sums


def test_leaves_of_one_color_leave_nothing_out(scene):
    g = scene.gaussians
    plain = replace(scene, gaussians=replace(g, sh=np.full_like(g.sh, 0.3)))
    assert color_variances(plain).max() < 1e-9  # the rounding of sums over 600 leaves


def test_a_sketch_of_leaves_is_empty_and_one_of_roots_is_all_that_is_covered(scene):
    sketcher = Sketcher.of(scene)
    leaves = st.select(scene, CAMERA, st.SelectOptions(pixel_error=0))
    assert vars(sketcher.draw(leaves.rows, CAMERA)) == {"merged": 0.0, "varied": 0.0}
    coarse = st.select(scene, CAMERA, st.SelectOptions(pixel_error=200))
    assert not scene.tree.is_leaf[coarse.rows].any()
    K = CAMERA.K.copy()
    K[:2] /= SKETCH_PX
    small = replace(CAMERA, K=K, width=CAMERA.width // SKETCH_PX, height=CAMERA.height // SKETCH_PX)
    alpha = st.render(scene, small, select=lambda *_, **__: coarse).alpha
    # 1 shown and what is behind it make the alpha; float32 of SH and blend.
    assert sketcher.draw(coarse.rows, CAMERA).merged == pytest.approx(float(alpha.mean()), rel=1e-4)


def test_what_is_hidden_does_not_count():
    """A merged crowd of black and white behind an opaque wall: seen from the front little of it is left, from behind all."""
    means = np.array([[0.02 * i, 0, 2] for i in range(16)] + [[0, 0, 0]], np.float32)
    colors = np.array([[i % 2] * 3 for i in range(16)] + [[0.5] * 3])
    gaussians = st.Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (17, 1)),
        log_scales=np.log(np.array([[0.2] * 3] * 16 + [[2, 2, 0.01]], np.float32)),
        logit_opacities=np.full(17, 4.5, np.float32),
        sh=(((colors - 0.5) / SH_C0).astype(np.float32))[:, None, :],
    )
    scene = st.build_lod(st.Scene.flat(gaussians), st.BuildOptions(max_roots=2, color_radius=None))
    sketcher = Sketcher.of(scene)
    rows = np.flatnonzero(scene.tree.depth == 0).astype(np.int32)
    hidden = sketcher.draw(rows, CAMERA)
    seen = sketcher.draw(rows, st.Camera.look_at([0, 0, 10], [0, 0, 0], width=240, height=160))
    assert seen.varied > 0.001
    assert hidden.varied < 0.05 * seen.varied  # the wall lets 1.1 % through


def test_a_sketch_has_the_same_bits_for_any_number_of_threads(scene):
    sketcher = Sketcher.of(scene)
    rows = st.select(scene, CAMERA, st.SelectOptions(pixel_error=40)).rows
    assert sketcher.draw(rows, CAMERA, threads=1) == sketcher.draw(rows, CAMERA, threads=3)
