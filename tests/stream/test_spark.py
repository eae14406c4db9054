"""Spark's choice as its heap makes it, and how many chunks of a .rad it needs."""

import heapq
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.rad.nodes import Nodes, log_sizes, nodes_of
from splatree.kernels.cpu.codec.paging import page_order
from splatree.kernels.reference import paging as reference
from splatree.maths.forests import links_from_preorder, parents_by_level
from splatree.stream.nodes import gaussians_of_tree
from splatree.stream.readers.spark import _sizes_in_view, chunks_loaded, select_spark

from .conftest import forest


@pytest.mark.parametrize("page_rows", [8, 64, 65536])
@pytest.mark.parametrize("joined", [0, 1])
@pytest.mark.parametrize("shape", ["forest", "flat", "stretched", "one place"])
def test_the_order_of_pages_is_as_defined(page_rows, joined, shape):
    scene = forest(700, seed=page_rows)
    means = scene.gaussians.means.copy()
    if shape == "flat":
        means[:, 2] = 1
    if shape == "stretched":
        means[:, 0] *= 40
    if shape == "one place":
        means[:] = 1
    sizes = np.round(scene.gaussians.log_scales.max(axis=1), 1)  # many equal ones
    arguments = (means, sizes, scene.tree.subtree_end, joined)
    found = page_order(*arguments, page_rows=page_rows)
    np.testing.assert_array_equal(found, reference.page_order(*arguments, page_rows=page_rows))
    assert np.array_equal(np.sort(found), np.arange(700))


def test_a_family_larger_than_a_page_has_an_order():
    end = np.concatenate([[100], np.arange(2, 101)]).astype(np.int32)
    arguments = (np.zeros((100, 3), np.float32), np.ones(100, np.float32), end, 0)
    np.testing.assert_array_equal(page_order(*arguments, page_rows=8), np.arange(100))
    np.testing.assert_array_equal(reference.page_order(*arguments, page_rows=8), np.arange(100))


def test_pages_end_with_a_family():
    """The families of a scene of 3,000 nodes are small beside pages of 64, so some always fill a page up; but for the regions
    whose nodes end within a page, no family begins in one page and ends in the next."""
    scene = forest(3000, seed=1)
    tree, sizes = scene.tree, scene.gaussians.log_scales.max(axis=1)
    links = links_from_preorder(tree.depth)
    num_children = np.empty(3000, int)
    num_children[links.row_from_node] = links.num_children

    def num_cut(rows):
        number = np.argsort(rows)
        parents = np.flatnonzero(num_children)
        first = number[parents + 1]
        return np.count_nonzero(first // 64 != (first + num_children[parents] - 1) // 64)

    arguments = (scene.gaussians.means, sizes, tree.subtree_end, 0)
    filled = num_cut(page_order(*arguments, page_rows=64))
    assert filled <= 0.5 * num_cut(reference.page_order(*arguments, page_rows=64, fills=False))


def test_children_follow_each_other_and_lie_in_two_chunks_at_most(tmp_path):
    scene = forest(3000, seed=1)
    nodes = nodes_of(scene, tmp_path / "a.rad")
    is_child = np.zeros(len(nodes), int)
    for first, count in zip(nodes.first_child, nodes.num_children, strict=True):
        is_child[first : first + count] += 1
    assert is_child[0] == 0 and np.all(is_child[1:] == 1)
    number = np.empty(3000, int)
    number[nodes.rows] = np.arange(len(nodes) - 3000, len(nodes))
    for rows, parents in parents_by_level(scene.tree.depth):
        first = nodes.first_child[number[parents]].astype(int)
        assert np.all((number[rows] >= first) & (number[rows] < first + nodes.num_children[number[parents]]))


def test_the_choice_is_that_of_a_heap():
    scene = forest(900, seed=3)
    camera = st.Camera.look_at([0.4, -0.3, -2.0], [0.5, 0.5, 0.5], width=200, height=150)
    looks = _sizes_in_view(scene, camera)
    end = scene.tree.subtree_end
    for budget in (40, 200, 600):
        drawn = [row for row in range(900) if scene.tree.depth[row] == 0]
        heap = [(-looks[row], row) for row in drawn]
        heapq.heapify(heap)
        count, leaves, opened = len(drawn), [], []
        while heap:
            look, row = heapq.heappop(heap)
            children = []
            child = row + 1
            while child < end[row]:
                children.append(child)
                child = int(end[child])
            if not children or -look * camera.K[1, 1] <= 1:
                leaves.append(row)
                continue
            if count + len(children) - 1 > budget:
                leaves += [row, *(row for _, row in heap)]
                break
            count += len(children) - 1
            opened.append(row)
            for child in children:
                heapq.heappush(heap, (-min(looks[child], -look), child))
        found = select_spark(scene, camera, budget)
        assert sorted(found.opened) == sorted(opened)
        assert found.drawn.tolist() == sorted(leaves) and len(found.drawn) <= budget


def paged(tree_scene, means, page_rows):
    """The nodes of a scene in the order of pages, with these centres."""
    tree, g = tree_scene.tree, tree_scene.gaussians
    links = links_from_preorder(tree.depth)
    rows = page_order(means, log_sizes(g), tree.subtree_end, 0, page_rows=page_rows)
    number, counts = np.append(np.argsort(rows), 0), np.empty(len(rows), np.int32)
    counts[links.row_from_node] = links.num_children
    first_child = np.where(counts[rows] > 0, number[rows + 1], 0)
    return Nodes(rows, counts[rows], first_child.astype(np.uint32), st.Gaussians.empty(g.sh_degree), None)


def test_a_view_needs_few_chunks(city_tree):
    """Of pages of 4,096 nodes, as many as a scene of 5 M has of 65,536, a view of 1.5 pages of nodes needs at most
    half of those that breadth-first order needs: here 4 for 14 seen from far, where 2 are the least. A few nodes far away move
    borders between the parts of the rest so little that a chunk more is needed."""
    city_tree = replace(city_tree, gaussians=gaussians_of_tree(city_tree, 4.0))  # as streams for Spark hold it
    page_rows, tree, g = 4096, city_tree.tree, city_tree.gaussians
    links = links_from_preorder(tree.depth)
    no_root = st.Gaussians.empty(g.sh_degree)
    breadth_first = Nodes(links.row_from_node, links.num_children, links.first_child.astype(np.uint32), no_root, None)
    far_out = g.means.copy()
    far_out[::100] *= 1000
    orders = paged(city_tree, g.means, page_rows), paged(city_tree, far_out, page_rows), breadth_first

    centre = np.median(g.means, axis=0)
    radius = float(np.quantile(np.linalg.norm(g.means - centre, axis=1), 0.9))
    near = st.Camera.look_at(centre + [0, -0.2 * radius, 0.1 * radius], centre + [0, 0, radius])
    far = st.Camera.look_at(centre + [0, -radius, -3 * radius], centre)
    for camera in (near, far):
        view = select_spark(city_tree, camera, int(1.5 * page_rows), least_px=0.0)
        needed, with_far_out, before = (len(chunks_loaded(n, view, page_rows=page_rows)) for n in orders)
        assert needed <= 0.5 * before and with_far_out <= max(1.2 * needed, needed + 1), (needed, with_far_out, before)
