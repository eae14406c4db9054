"""A .rad leaves out the nodes that Spark opens right after their parent."""

from dataclasses import replace

import numpy as np

import splatree as st
from splatree.io.formats.rad.nodes import log_sizes
from splatree.stream.families import without_equals
from splatree.stream.readers.spark import select_spark

from .conftest import forest


def path_to(tree, row):
    return [above for above in range(row + 1) if tree.subtree_end[above] > row]


def test_what_stays_is_what_the_definition_says():
    scene = forest(400, seed=3)
    tree, sizes = scene.tree, log_sizes(scene.gaussians)
    expected = []
    for row in range(len(tree)):
        above = [other for other in path_to(tree, row)[:-1] if other in expected]
        is_small = not above or sizes[row] < min(sizes[above]) + np.float32(np.log(0.8))
        if tree.is_leaf[row] or tree.depth[row] == 0 or is_small:
            expected.append(row)
    ids = np.arange(len(tree), dtype=np.uint32)
    left = without_equals(replace(scene, ids=ids))
    assert left.ids.tolist() == expected and 10 < len(expected) < len(tree) - 10
    np.testing.assert_array_equal(left.gaussians.means, scene.gaussians.means[expected])
    for row, old in enumerate(expected):
        below = range(old, int(tree.subtree_end[old]))
        assert left.ids[row : left.tree.subtree_end[row]].tolist() == [other for other in expected if other in below]


def test_spark_draws_the_same_leaves_without_them():
    """Such a node is opened right after its parent, so no budget stops between them, but for one within the family."""
    scene = forest(600, seed=4)
    camera = st.Camera.look_at([0.5, 0.5, -3.0], [0.5, 0.5, 0.5], width=96, height=64)
    left = without_equals(scene)
    every = len(scene)
    drawn, wanted = select_spark(left, camera, every, least_px=0), select_spark(scene, camera, every, least_px=0)
    np.testing.assert_array_equal(left.gaussians.means[drawn.drawn], scene.gaussians.means[wanted.drawn])


def test_a_rad_has_fewer_nodes_than_the_tree_and_all_leaves(tmp_path):
    scene = forest(900, seed=2)
    written = st.stream(scene, tmp_path / "city.rad", "rad")
    back = st.read(tmp_path / "city.rad")
    assert back.tree.num_leaves == scene.tree.num_leaves
    assert written.levels[0].num_nodes == len(without_equals(scene)) < len(scene)
    assert len(back) == written.levels[0].num_nodes
