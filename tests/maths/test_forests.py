from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree import GaussianTree, InputError
from splatree.maths import forests
from splatree.maths.forests import (
    family_extremes,
    links_from_preorder,
    parents_by_level,
    preorder_from_links,
    subtree_radii,
)


@st.composite
def depths(draw):
    """Depths of a forest in preorder: each row is at most one deeper than the one before."""
    steps = draw(st.lists(st.integers(0, 4), max_size=40))
    depth = [0] if steps else []
    for step in steps[1:]:
        depth.append(max(0, depth[-1] + 1 - step))
    return np.array(depth, np.uint8)


def parents_of(depth):
    """By definition: the last row before that is one less deep."""
    return [max((j for j in range(i) if int(depth[j]) == int(depth[i]) - 1), default=-1) for i in range(len(depth))]


@given(depth=depths())
def test_links_and_back_are_the_same_forest(depth):
    links = links_from_preorder(depth)
    num_roots = int((depth == 0).sum())
    order = preorder_from_links(links.first_child, links.num_children, np.arange(num_roots))
    np.testing.assert_array_equal(order.depth, depth)
    np.testing.assert_array_equal(links.row_from_node[order.node_from_row], np.arange(len(depth)))
    GaussianTree(order.subtree_end, order.depth, np.zeros(len(depth), np.float32))  # nested, or it raises


@given(depth=depths())
def test_nodes_are_breadth_first_and_know_their_parents(depth):
    links = links_from_preorder(depth)
    assert (np.diff(depth[links.row_from_node].astype(int)) >= 0).all()
    wanted = parents_of(depth)
    for node, parent in enumerate(links.parents):
        row = links.row_from_node[node]
        assert wanted[row] == (links.row_from_node[parent] if parent >= 0 else -1)
        children = range(links.first_child[node], links.first_child[node] + links.num_children[node])
        assert [links.parents[child] for child in children] == [node] * len(children)


@given(depth=depths(), rows_at_once=st.sampled_from([1, 3, 1 << 16]))
def test_parents_come_before_their_children(depth, rows_at_once):
    with mock.patch.object(forests, "_ROWS_AT_ONCE", rows_at_once):
        steps = list(parents_by_level(depth))
    found = {int(row): int(p) for rows, above in steps for row, p in zip(rows, above, strict=True)}
    assert found == {row: parent for row, parent in enumerate(parents_of(depth)) if parent >= 0}
    done = set(np.flatnonzero(depth == 0).tolist())
    for rows, above in steps:
        assert set(above.tolist()) <= done and len(set(depth[rows].tolist())) == 1 and (np.diff(rows) > 0).all()
        done |= set(rows.tolist())


@pytest.mark.parametrize(
    ("first", "count", "message"),
    [
        ([1, 0, 0], [2, 0, 1], "several ways|child of two|own ancestor"),  # 2 leads back to the root
        ([1, 2, 1], [1, 1, 1], "child of two or its own ancestor"),  # 1 and 2 in a circle
        ([0, 0, 0], [0, 0, 0], "node 1: found no ways"),
        ([1, 0, 0], [3, 0, 0], "node 0: found 3 children from node 1, wanted nodes 0 to 2"),
        ([-1, 0, 0], [2, 0, 0], "node 0: found 2 children from node -1"),
        ([1, 0, 0], [-2, 0, 0], "node 0: found -2 children"),
        ([1, 1, 0], [1, 1, 0], "own ancestor|several"),
    ],
)
def test_links_that_are_no_tree_are_refused(first, count, message):
    with pytest.raises(InputError, match=message):
        preorder_from_links(np.array(first), np.array(count), np.zeros(1, np.int64))


def test_a_chain_ends_at_the_depth_of_a_byte():
    first, count = np.arange(1, 258), np.ones(257, int)
    count[255] = 0
    assert preorder_from_links(first[:256], count[:256], np.zeros(1, int)).depth[-1] == 255
    count[255], count[256] = 1, 0
    with pytest.raises(InputError, match="deeper than 255"):
        preorder_from_links(first, count, np.zeros(1, int))


@given(depth=depths(), seed=st.integers(0, 1000))
def test_balls_and_boxes_hold_all_descendants(depth, seed):
    rng = np.random.default_rng(seed)
    n = len(depth)
    means, reach = rng.standard_normal((n, 3)).astype(np.float32), rng.random(n)
    radii = subtree_radii(means, reach, depth).astype(np.float64)
    low, high = means - reach[:, None], means + reach[:, None]
    low_of_all, high_of_all = low.copy(), high.copy()
    family_extremes(low_of_all, high_of_all, depth)
    parents = parents_of(depth)
    for row in range(n):
        above = row
        while above >= 0:
            # The true distance, so the bound must hold exactly: it is rounded upwards.
            assert np.linalg.norm(means[row].astype(np.float64) - means[above]) + reach[row] <= radii[above]
            assert (low_of_all[above] <= low[row]).all() and (high_of_all[above] >= high[row]).all()
            above = parents[above]


def test_radii_beyond_float32_end_at_its_largest():
    largest = np.finfo(np.float32).max
    radii = subtree_radii(np.zeros((2, 3), np.float32), np.array([1.0, 1e300]), np.uint8([0, 1]))
    assert radii.tolist() == [largest, largest]
