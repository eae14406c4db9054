from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree import GaussianTree, ShapeError
from splatree.scene import tree

run_lengths = st.sampled_from([1, 3, 1 << 16])
"""Rows that are looked at together."""


def tree_from_parents(parents: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Subtree ends and depths of a forest given by parents, where each parent is on the current root path."""
    n = len(parents)
    depth = np.zeros(n, np.uint8)
    end = np.arange(1, n + 1, dtype=np.int32)
    for i, p in enumerate(parents):
        if p >= 0:
            depth[i] = depth[p] + 1
    for i in reversed(range(n)):
        if parents[i] >= 0:
            end[parents[i]] = max(end[parents[i]], end[i])
    return end, depth


@st.composite
def preorder_parents(draw: st.DrawFn) -> list[int]:
    parents: list[int] = []
    path: list[int] = []
    for i in range(draw(st.integers(0, 25))):
        keep = draw(st.integers(0, len(path)))
        path = path[:keep]
        parents.append(path[-1] if path else -1)
        path.append(i)
    return parents


def build(end: np.ndarray, depth: np.ndarray) -> GaussianTree:
    return GaussianTree(end, depth, np.ones(len(end), np.float32))


@given(preorder_parents(), run_lengths)
def test_each_forest_in_preorder_is_accepted(parents, rows_at_once):
    end, depth = tree_from_parents(parents)
    with mock.patch.object(tree, "_ROWS_AT_ONCE", rows_at_once):
        built = build(end, depth)
        assert built.num_leaves == built.is_leaf.sum() == len(parents) - len(set(parents) - {-1})
        np.testing.assert_array_equal(built.is_leaf, ~np.isin(np.arange(len(parents)), parents))


@given(preorder_parents(), st.data(), run_lengths)
def test_any_other_subtree_end_is_refused(parents, data, rows_at_once):
    end, depth = tree_from_parents(parents)
    if not len(end):
        return
    i = data.draw(st.integers(0, len(end) - 1))
    wrong = data.draw(st.integers(-1, len(end) + 1).filter(lambda e: e != end[i]))
    end[i] = wrong
    with mock.patch.object(tree, "_ROWS_AT_ONCE", rows_at_once), pytest.raises(ShapeError):
        build(end, depth)


@given(preorder_parents(), st.data(), run_lengths)
def test_a_wrong_depth_is_refused(parents, data, rows_at_once):
    end, depth = tree_from_parents(parents)
    if not len(end):
        return
    i = data.draw(st.integers(0, len(end) - 1))
    depth[i] = data.draw(st.integers(0, 30).filter(lambda d: d != depth[i]))
    with mock.patch.object(tree, "_ROWS_AT_ONCE", rows_at_once), pytest.raises(ShapeError):
        build(end, depth)
