"""A cut between a coarse and a fine one."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splatree.stream.levels import intervals_of
from splatree.view.steps import mixed

from ..stream.conftest import forest

forests = st.builds(
    lambda n, roots, seed: forest(max(n, roots), seed=seed, num_roots=roots),
    st.integers(1, 120),
    st.integers(1, 4),
    st.integers(0, 10**6),
)


@given(forests, st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.integers(0, 10**6))
@settings(max_examples=100, deadline=None)
def test_a_mixed_cut_draws_every_leaf_once_and_brings_no_node_but_coarse_ones(scene, one, other, share, seed):
    tree, sizes = scene.tree, np.sort(scene.tree.extents)
    low, high = sorted(float(sizes[int(place * (len(sizes) - 1))]) for place in (one, other))
    intervals = intervals_of(tree)
    coarse, fine = intervals.rows_at(high), intervals.rows_at(low)
    is_held = np.random.default_rng(seed).random(len(fine)) < share
    found = mixed(coarse, fine, is_held)
    drawn = np.zeros(len(scene) + 1, int)
    np.add.at(drawn, found, 1)
    np.add.at(drawn, tree.subtree_end[found], -1)
    assert (np.cumsum(drawn)[:-1][tree.is_leaf] == 1).all() and (np.diff(found) > 0).all()
    assert set(found) <= set(coarse) | set(fine[is_held])
    held = set(fine[is_held])
    for row in coarse:
        below = {r for r in fine if row <= r < tree.subtree_end[row]}
        assert below <= set(found) if below <= held else row in found


def test_parts_that_the_coarse_cut_leaves_out_wait_unless_they_are_held():
    coarse, fine = np.int32([10, 20]), np.int32([3, 4, 11, 12, 25])
    found = mixed(coarse, fine, np.array([True, False, True, True, False]))
    assert found.tolist() == [3, 11, 12, 20]
    assert mixed(coarse, fine[:0], np.zeros(0, bool)).tolist() == []
    assert mixed(coarse[:0], fine, np.ones(5, bool)).tolist() == fine.tolist()
