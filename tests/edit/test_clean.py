"""Filters that look at the whole scene: size, distance, pieces that touch nothing."""

import numpy as np
import pytest

import splatree as st
from splatree.errors import InputError


def scene_of(means, log_scale=-4.0, opacity_logit=3.0):
    n = len(means)
    return st.Scene.flat(
        st.Gaussians(
            np.asarray(means, np.float32),
            np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
            np.broadcast_to(np.float32(log_scale), (n, 3)).copy() if np.ndim(log_scale) == 0 else
            np.repeat(np.float32(log_scale)[:, None], 3, axis=1),
            np.broadcast_to(np.float32(opacity_logit), n).copy(),
            np.zeros((n, 1, 3), np.float32),
        )
    )  # fmt: skip


@pytest.fixture(scope="module")
def ball():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(6000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return 2 * directions * rng.random((6000, 1)) ** (1 / 3)


def test_a_piece_that_touches_nothing_is_a_floater(ball):
    speck = np.array([5.0, 0, 0]) + 0.05 * np.random.default_rng(1).normal(size=(30, 3))
    cleaned = st.clean(scene_of(np.concatenate([ball, speck])), st.CleanOptions(floaters=True, cell=0.2))
    assert cleaned.dropped == {"floaters": 30} and cleaned.num_dropped == 30
    assert np.array_equal(cleaned.scene.gaussians.means, np.float32(ball))


def test_a_large_piece_stays_and_what_touches_at_a_corner_belongs_to_it():
    grid = np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3)
    diagonal = np.array([[10.0, 10, 10], [11, 11, 11]])
    means = np.concatenate([grid, grid + 40, diagonal, [[25.0, 25, 25]]]) + 0.5
    options = st.CleanOptions(
        floaters=True, cell=1 / np.median(np.linalg.norm(means - np.median(means, axis=0), axis=1))
    )
    cleaned = st.clean(scene_of(means), options)
    assert cleaned.num_dropped == 1
    assert [25.5] * 3 not in cleaned.scene.gaussians.means.tolist()


def test_faint_gaussians_join_nothing(ball):
    bridge = np.linspace([2, 0, 0], [5, 0, 0], 200)
    speck = np.array([5.0, 0, 0]) + 0.05 * np.random.default_rng(1).normal(size=(30, 3))
    logits = np.concatenate([np.full(6000, 3.0), np.full(200, -4.0), np.full(30, 3.0)])
    cleaned = st.clean(
        scene_of(np.concatenate([ball, bridge, speck]), opacity_logit=logits), st.CleanOptions(floaters=True, cell=0.2)
    )
    assert cleaned.num_dropped > 200


def test_sizes_and_distances(ball):
    sizes = np.full(6000, -4.0)
    sizes[:3], sizes[3:5] = 1.0, -12.0
    scene = scene_of(np.concatenate([ball[:5999], [[1e6, 0, 0]]]), log_scale=sizes)
    options = st.CleanOptions(max_size=2.0, min_size=1e-4, max_distance=10)
    cleaned = st.clean(scene, options)
    assert cleaned.dropped == {"larger than max_size": 3, "smaller than min_size": 2, "farther than max_distance": 1}
    assert cleaned.num_dropped == 6 and len(cleaned.scene) == 5994


def test_distances_may_be_those_to_the_cameras(ball):
    far = ball + [100, 0, 0]
    cameras = np.array([[x, 0, 0] for x in np.linspace(-4, 4, 9)])
    both = scene_of(np.concatenate([ball, far]))
    cleaned = st.clean(both, st.CleanOptions(max_distance=5), cameras=cameras)
    assert cleaned.num_dropped == 6000
    assert np.array_equal(cleaned.scene.gaussians.means, np.float32(ball))


def test_levels_keep_the_nodes_above_what_stays(ball):
    speck = np.array([5.0, 0, 0]) + 0.05 * np.random.default_rng(1).normal(size=(30, 3))
    tree = st.build_lod(scene_of(np.concatenate([ball, speck])))
    cleaned = st.clean(tree, st.CleanOptions(floaters=True, cell=0.2))
    assert cleaned.scene.tree.num_leaves == 6000
    assert cleaned.scene.tree.num_levels > 1


def test_filters_that_leave_nothing_are_refused(ball):
    with pytest.raises(InputError, match="drop all 6,000"):
        st.clean(scene_of(ball), st.CleanOptions(max_size=1e-9))
    for wrong in ({"cell": 0}, {"max_size": -1}, {"smallest_piece": 1}):
        with pytest.raises(InputError):
            st.CleanOptions(**wrong)


def test_nothing_is_left_of_nothing():
    empty = st.Scene.flat(st.Gaussians.empty())
    assert st.clean(empty, st.CleanOptions(floaters=True, max_distance=2)).num_dropped == 0
