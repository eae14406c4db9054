import numpy as np
import pytest

from splatree import InputError
from splatree.lod.order import Families, preorder


def chain(num_levels):
    """A root over a leaf and a node over a leaf and a node …: its deepest node is ``num_levels`` edges down."""
    levels = []
    deepest = 0
    for i in range(num_levels):
        levels.append(Families(num_levels + 1 + i, np.int32([deepest, i + 1]), np.array([0])))
        deepest = num_levels + 1 + i
    n = 2 * num_levels + 1
    means = np.zeros((n, 3), np.float32)
    means[1 : num_levels + 1, 0] = 1
    return levels, np.int32([n - 1]), means, np.full(n, 0.5)


def test_rows_are_in_preorder_and_extents_hold_descendants():
    levels, roots, means, reach = chain(2)
    order = preorder(levels, roots, means, reach)
    # The root 4 over 3 and leaf 2; 3 over leaves 0 and 1.
    assert order.row_from_node.tolist() == [2, 3, 4, 1, 0]
    assert order.tree.subtree_end.tolist() == [5, 4, 3, 4, 5]
    assert order.tree.depth.tolist() == [0, 1, 2, 2, 1]
    # A leaf at distance 1 reaches to 1½ from its parent; nodes at one place add nothing. Rounding is upwards.
    wanted = np.array([1.5, 1.5, 0.5, 0.5, 0.5])
    assert (order.tree.extents > wanted).all()
    np.testing.assert_allclose(order.tree.extents, wanted, rtol=1e-6)


def test_several_roots_keep_their_order():
    levels = [Families(4, np.int32([1, 0]), np.array([0]))]
    order = preorder(levels, np.int32([3, 4, 2]), np.zeros((5, 3), np.float32), np.ones(5))
    assert order.row_from_node.tolist() == [3, 2, 4, 0, 1]
    assert order.tree.depth.tolist() == [0, 0, 1, 1, 0]


def test_extents_beyond_float32_end_at_its_largest():
    levels, roots, means, reach = chain(1)
    reach[0] = 1e300
    order = preorder(levels, roots, means, reach)
    assert order.tree.extents.max() == np.finfo(np.float32).max


def test_a_depth_fits_into_a_byte_or_is_refused():
    assert preorder(*chain(255)).tree.depth.max() == 255
    with pytest.raises(InputError, match="found a node 256 levels below its root, wanted at most 255"):
        preorder(*chain(256))


def test_nothing_is_a_tree():
    order = preorder([], np.zeros(0, np.int32), np.zeros((0, 3), np.float32), np.zeros(0))
    assert len(order.tree) == 0
