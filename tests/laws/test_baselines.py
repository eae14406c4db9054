"""Laws of the published methods: who draws each leaf once, who does not, and what the compiled rules must agree with."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from splatree import (
    BuildOptions,
    Camera,
    Gaussians,
    GaussianTree,
    InputError,
    Scene,
    SelectOptions,
    build_lod,
    render,
    select,
)
from splatree.kernels.cpu.frame import baselines as cpu
from splatree.kernels.cpu.frame import select as cpu_select
from splatree.kernels.reference import baselines as reference
from splatree.kernels.reference import select as reference_select
from splatree.lod.baselines import BaselineName, BaselineOptions, Request, baseline, log_serial, violations
from splatree.lod.select import count_uncovered
from splatree.scene.view import View, view_of

from ..lod.test_select import camera_at, quad_tree
from ..scenes import surface

CUTS = ("3dgs", "roots", "depth", "h3dgs", "serial", "octree", "flod", "filtergs")
PER_NODE = ("octree-per-node", "flod-per-node", "lodge")
seeds = st.integers(0, 2**20)
few = settings(max_examples=30)  # a scene of hundreds of rows each, and Python walks it
taus = st.sampled_from([0.0, 1.0, 1.7, 3.0, 8.0, 100.0, np.inf])


def forest(seed: int) -> Scene:
    """Up to 400 rows in trees of up to nine levels, each row about half as large as its parent; sometimes nothing at all."""
    rng = np.random.default_rng(seed)
    n = int(rng.choice([0, 1, 7, 60, 400]))
    depth = np.zeros(n, np.uint8)
    means, log_scales = 4 * rng.normal(size=(n, 3)), rng.normal(0, 0.6, (n, 3))
    end = np.arange(1, n + 1, dtype=np.int32)
    path: list[int] = []
    for i in range(n):
        path = path[: int(rng.integers(0, min(len(path), 8) + 1))] if rng.random() < 0.6 else path[:8]
        depth[i] = len(path)
        if path:
            means[i] = means[path[-1]] + np.exp(log_scales[path[-1]].mean()) * rng.normal(size=3)
            log_scales[i] += log_scales[path[-1]] - 0.7
        path.append(i)
        end[path] = i + 1
    columns = (means, rng.normal(size=(n, 4)), log_scales, rng.normal(0, 3, n), rng.normal(size=(n, 1, 3)))
    gaussians = Gaussians(*(column.astype(np.float32) for column in columns))
    return Scene(gaussians, GaussianTree(end, depth, np.ones(n, np.float32)))


def camera_of(seed: int) -> Camera:
    rng = np.random.default_rng(seed + 1)
    position = rng.normal(size=3) * rng.choice([0.1, 3.0, 15.0, 80.0])
    return Camera.look_at(
        position, rng.normal(size=3), width=160, height=90, fov_y_deg=float(rng.choice([20, 60, 110]))
    )


def near(values: np.ndarray, limit: float) -> np.ndarray:
    """Whether float32 may fall on the other side of the limit."""
    return np.abs(values - limit) < 1e-4 * np.abs(limit)


@few
@given(seeds, taus)
def test_the_three_schemes_find_the_same_rows_bit_for_bit(seed, tau):
    # By blocks, level by level, and with a table of ancestors.
    scene, camera, options = forest(seed), camera_of(seed), BaselineOptions(pixel_error=tau)
    wanted = select(scene, camera, SelectOptions(pixel_error=tau)).rows
    for method in ("serial", "filtergs"):
        made = baseline(method, scene, options=options)
        for threads in (1, 2):
            rows = made(view_of(scene, camera), threads=threads).rows
            assert rows.tolist() == wanted.tolist()


@few
@pytest.mark.parametrize("method", CUTS)
@given(seed=seeds, tau=taus)
def test_a_method_that_replaces_nodes_draws_each_leaf_once(method, seed, tau):
    scene, camera = forest(seed), camera_of(seed)
    options = BaselineOptions(pixel_error=tau, depth=seed % 5)
    rows = baseline(method, scene, [camera], options).cut(camera)
    found = violations(scene.tree, rows)
    assert (found.duplicates, found.uncovered) == (0, 0)
    assert rows.tolist() == sorted(set(rows.tolist()))


@few
@pytest.mark.parametrize("method", PER_NODE)
@given(seed=seeds)
def test_violations_of_rules_that_ask_each_node_alone_are_counted(method, seed):
    scene, camera = forest(seed), camera_of(seed)
    tree, rows = scene.tree, baseline(method, scene, [camera]).cut(camera)
    drawn = set(rows.tolist())
    above = [[u for u in range(v) if tree.subtree_end[u] > v] for v in range(len(tree))]
    duplicates = sum(bool(drawn.intersection(above[v])) for v in drawn)
    uncovered = sum(not drawn.intersection([v, *above[v]]) for v in np.flatnonzero(tree.is_leaf).tolist())
    found = violations(tree, rows)
    assert (found.duplicates, found.uncovered) == (duplicates, uncovered)


def test_rules_that_ask_each_node_alone_do_draw_twice_and_leave_holes():
    # Over these scenes at least; a counter that is always 0 would prove nothing.
    scenes = [(scene, camera_of(s)) for s in range(40) if len(scene := forest(s)) > 7]
    for method in PER_NODE:
        options = BaselineOptions(fork=1.1, bands=9)  # bands as narrow as can be: they meet everywhere
        found = [violations(s.tree, baseline(method, s, [camera], options).cut(camera)) for s, camera in scenes]
        assert sum(v.duplicates for v in found) > 0
        assert sum(v.uncovered for v in found) > 0


@few
@given(seeds)
def test_trivial_methods_are_leaves_roots_and_one_depth(seed):
    scene, camera = forest(seed), camera_of(seed)
    tree = scene.tree
    assert baseline("3dgs", scene).cut(camera).tolist() == np.flatnonzero(tree.is_leaf).tolist()
    assert baseline("roots", scene).cut(camera).tolist() == np.flatnonzero(tree.depth == 0).tolist()
    rows = baseline("depth", scene, options=BaselineOptions(depth=2)).cut(camera)
    assert (tree.depth[rows] <= 2).all() and tree.is_leaf[rows[tree.depth[rows] < 2]].all()


@few
@given(seeds, st.sampled_from([0.0, 3.0, 15.0]))
def test_h3dgs_is_its_own_test_of_the_parent(seed, tau):
    scene, camera = forest(seed), camera_of(seed)
    tree = scene.tree
    lower, upper = reference.nested_boxes(scene.gaussians, tree)
    for mine, theirs in zip(cpu.nested_boxes(scene.gaussians, tree), (lower, upper), strict=True):
        np.testing.assert_array_equal(mine, theirs)  # minima and maxima do not round
    small = cpu.small_boxes(lower, upper, camera.position, 2 * (tau + 0.5) / camera.K[0, 0]).astype(bool)
    parent = [max((u for u in range(v) if tree.subtree_end[u] > v), default=-1) for v in range(len(tree))]
    assert all(small[v] for v, p in enumerate(parent) if p >= 0 and small[p])  # the size never grows towards the leaves
    wanted = [
        v for v in range(len(tree)) if (tree.is_leaf[v] or small[v]) and not (parent[v] >= 0 and small[parent[v]])
    ]
    assert baseline("h3dgs", scene, options=BaselineOptions(pixel_error=tau)).cut(camera).tolist() == wanted


@few
@given(seeds)
def test_compiled_flags_are_those_of_the_definition(seed):
    scene, camera = forest(seed), camera_of(seed)
    lower, upper = reference.nested_boxes(scene.gaussians, scene.tree)
    eye = camera.position.astype(np.float32)
    for limit in (0.01, 0.2, 3.0):
        differ = cpu.small_boxes(lower, upper, eye, limit) != reference.small_boxes(lower, upper, eye, limit)
        distances = np.linalg.norm(np.maximum(0, np.maximum(lower - eye, eye - upper)), axis=1)
        assert near((upper - lower).max(axis=1, initial=0), limit * distances)[differ].all()
    edges, depths = np.array([0.5, 3.0, 12.0]), np.array([8, 3, 2, 0])
    fast, slow = (kernels.depth_flags(scene.gaussians, scene.tree, eye, edges, depths) for kernels in (cpu, reference))
    distances = np.linalg.norm(scene.gaussians.means - eye, axis=1)
    assert np.any([near(distances, edge) for edge in edges], axis=0)[fast != slow].all()
    for least in (1, 2):
        rows = [kernels.first_stops(scene.tree, fast, least).tolist() for kernels in (cpu, reference)]
        assert rows[0] == rows[1]


@few
@pytest.mark.parametrize("rule", ["paper-strict", "release"])
@given(seed=seeds, tau=st.sampled_from([0.0, 2.5, 3.0, 8.0, 100.0, 1e9]))
def test_ancestor_table_decides_as_the_definition_of_each_rule(rule, seed, tau):
    scene, camera = forest(seed), camera_of(seed)
    table = cpu_select.ancestor_table(scene.tree)
    # Where a row lies in the band in which float32 may fall either way the sets cannot be compared.
    options = SelectOptions(tau, rule=rule, profile="ref", view_test="centre")
    radii = reference_select.radii(scene.gaussians, scene.tree.extents, camera, "ref", 0.3)
    splats = reference_select.project(scene.gaussians, camera)
    seen = [reference_select.centred(splats, camera, pad) for pad in (0.0999, 0.1001)]
    assume(not (near(radii, tau).any() or (seen[0] != seen[1]).any() or near(splats.depths, camera.near).any()))
    view = View(camera)
    rows, visited = cpu_select.select_by_ancestors(scene.gaussians, scene.tree, table, view, options)
    wanted, _ = reference_select.select(scene.gaussians, scene.tree, None, view, options)
    assert rows.tolist() == wanted.tolist()
    assert visited == len(scene)


@few
@given(seeds)
def test_ancestor_table_lists_parents_first(seed):
    tree = forest(seed).tree
    table = cpu_select.ancestor_table(tree)
    for row in range(len(tree)):
        above = [u for u in range(row) if tree.subtree_end[u] > row][::-1]
        assert table[row].tolist() == above + [-1] * (table.shape[1] - len(above))


def test_what_lies_out_of_view_shadows_in_the_cut_and_not_in_the_papers_literal_reading():
    # A small parent, out of view, of a leaf in view: only where the parent counts is the leaf not drawn.
    means = np.array([[40, 0, 0], [0, 0, 0]], np.float32)
    columns = (means, np.tile([1.0, 0, 0, 0], (2, 1)), np.full((2, 3), -3.0), np.zeros(2), np.zeros((2, 1, 3)))
    gaussians = Gaussians(*(np.asarray(column, np.float32) for column in columns))
    scene = Scene(gaussians, GaussianTree(np.int32([2, 2]), np.uint8([0, 1]), np.float32([41, 1])))
    camera = Camera.look_at(np.array([0.0, 0, -50]), np.zeros(3), width=64, height=64, fov_y_deg=30)
    options = BaselineOptions(pixel_error=5.0)
    assert len(baseline("filtergs", scene, options=options)(View(camera)).rows) == 0
    assert baseline("filtergs-strict", scene, options=options)(View(camera)).rows.tolist() == [1]


def test_lodge_draws_the_list_of_the_nearest_place():
    scene = forest(4)
    cameras = [Camera.look_at(np.array([x, 0.0, -60.0]), np.zeros(3)) for x in (-90.0, -89.0, 200.0)]
    made = baseline("lodge", scene, cameras, BaselineOptions(chunks=2))
    assert made.cut(cameras[0]).tolist() == made.cut(cameras[1]).tolist() != made.cut(cameras[2]).tolist()
    between = Camera.look_at(np.array([-80.0, 5.0, -50.0]), np.zeros(3))
    assert made.cut(between).tolist() == made.cut(cameras[0]).tolist()


def test_the_release_of_filtergs_drops_what_is_larger_than_700_px():
    columns = (np.zeros((1, 3)), [[1.0, 0, 0, 0]], np.full((1, 3), 1.0), np.zeros(1), np.zeros((1, 1, 3)))
    scene = Scene.flat(Gaussians(*(np.asarray(column, np.float32) for column in columns)))
    # 3σ is 8.2: with a focal length of 100 px its radius is 700 px at a distance of 1.17.
    for distance, drawn in ((1.1, 0), (1.25, 1)):
        pose = np.eye(4)
        pose[2, 3] = distance
        camera = Camera(pose, np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]]), 100, 100)
        assert len(baseline("filtergs", scene)(View(camera)).rows) == 1
        assert len(baseline("filtergs-release", scene)(View(camera)).rows) == drawn
        assert len(baseline("filtergs-release", scene).cut(camera)) == 1  # of the whole scene, seen or not


def test_methods_count_the_bytes_of_what_they_keep_beside_the_tree():
    scene, camera = forest(4), Camera.look_at(np.array([0.0, 0, -60]), np.zeros(3))
    made = {method: baseline(method, scene, [camera], BaselineOptions(chunks=1)) for method in get_args(BaselineName)}
    num_bands = min(BaselineOptions().bands, scene.tree.num_levels)
    assert made["flod"].num_bytes == 4 * (num_bands + num_bands - 1)  # a depth a band, a distance between two
    assert made["lodge"].num_bytes == made["lodge"].cut(camera).nbytes  # the one list
    assert made["filtergs"].num_bytes == cpu_select.ancestor_table(scene.tree).nbytes


def test_log_serial_loses_the_subtrees_of_roots_that_are_not_passed_on():
    scene, camera = forest(4), Camera.look_at(np.array([0.0, 0, -60]), np.zeros(3))
    roots = np.flatnonzero(scene.tree.depth == 0)
    select_all = SelectOptions(3.0, rule="log-serial", profile="ref")
    rows, _ = log_serial(scene, select_all)(Request(View(camera), "none", 0))
    fewer, _ = log_serial(scene, select_all, roots[1:])(Request(View(camera), "none", 0))
    gone = (rows >= roots[0]) & (rows < scene.tree.subtree_end[roots[0]])
    assert fewer.tolist() == rows[~gone].tolist()


def test_every_method_is_drawn_by_the_renderer():
    scene, camera = forest(4), Camera.look_at(np.array([0.0, 0, -30]), np.zeros(3), width=48, height=32)
    for method in get_args(BaselineName):
        result = render(scene, camera, select=baseline(method, scene, [camera]))
        assert result.counters.num_selected > 0
        assert np.isfinite(result.image).all()


def test_methods_that_need_the_training_cameras_say_so():
    for method in ("octree", "lodge"):
        with pytest.raises(InputError, match="found no cameras"):
            baseline(method, forest(4))
    with pytest.raises(InputError, match="'quadtree', wanted '3dgs', 'roots'"):
        baseline("quadtree", forest(4))
    with pytest.raises(InputError, match="fork: found 1"):
        BaselineOptions(fork=1)


def test_a_cover_of_nothing_leaves_every_leaf_uncovered():
    tree = forest(4).tree
    assert count_uncovered(tree, np.zeros(0, np.int32)) == tree.num_leaves
    assert count_uncovered(tree, np.flatnonzero(tree.depth == 0)) == 0


PROFILES = {
    "serial": "exact",
    "filtergs": "exact",
    "log-serial": "ref",
    "filtergs-strict": "ref",
    "filtergs-release": "ref",
}


def test_each_method_says_which_radius_it_compares():
    scene, camera = quad_tree(4), camera_at(2.0)
    for method in get_args(BaselineName):
        made = baseline(method, scene, [camera], BaselineOptions(chunks=1))
        assert made(View(camera)).profile == PROFILES.get(method)


@pytest.mark.parametrize("method", ["serial", "filtergs"])
def test_the_exact_cut_is_that_of_the_levels(method):
    """Levels by pairs are drawn by their pixels: the baselines of the exact cut draw the rows that `select` draws."""
    scene = build_lod(Scene.flat(surface(600)), BuildOptions("pairs"))
    made, camera = baseline(method, scene), camera_at(12.0)
    assert made(View(camera)).profile == "pixel"
    np.testing.assert_array_equal(made(View(camera)).rows, select(scene, camera).rows)
