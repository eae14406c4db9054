"""Laws of the selection: properties 1 to 8 that any implementation of the cut has to have."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree import Camera, Gaussians, GaussianTree, Scene, SelectOptions, select
from splatree.kernels.reference import select as reference
from splatree.lod.select import count_nested
from splatree.lod.serial import child_table_of, select_serial
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.view import view_of

PROFILES = ("exact", "3dgs", "ref", "sphere", "pixel")
taus = st.sampled_from([0.25, 0.5, 1.0, 2.5, 3.0, 1e9, np.inf])


@st.composite
def forests(draw: st.DrawFn) -> list[int]:
    """Parent of each row in preorder, −1 for a root: incomplete families, single nodes, chains, several roots, nothing."""
    kind = draw(st.sampled_from(["any", "any", "any", "chain", "singles", "empty"]))
    if kind == "empty":
        return []
    if kind == "singles":
        return [-1] * draw(st.integers(1, 6))
    if kind == "chain":
        return list(range(-1, 30)) + [-1] * draw(st.integers(0, 2))
    parents: list[int] = []
    path: list[int] = []
    for i in range(draw(st.integers(1, 40))):
        path = path[: draw(st.integers(0, len(path)))]
        parents.append(path[-1] if path else -1)
        path.append(i)
    return parents


def tree_of(parents: list[int], extents: np.ndarray | None = None) -> GaussianTree:
    n = len(parents)
    depth = np.zeros(n, np.uint8)
    end = np.arange(1, n + 1, dtype=np.int32)
    for i, p in enumerate(parents):
        depth[i] = depth[p] + 1 if p >= 0 else 0
    for i in reversed(range(n)):
        if parents[i] >= 0:
            end[parents[i]] = max(end[parents[i]], end[i])
    return GaussianTree(end, depth, np.ones(n, np.float32) if extents is None else extents)


def scene_of(parents: list[int], seed: int) -> Scene:
    """Gaussians that get about half as large from level to level, some of them not; extents are nested balls."""
    rng = np.random.default_rng(seed)
    n = len(parents)
    means, log_scales = np.zeros((n, 3)), np.zeros((n, 3))
    for i, p in enumerate(parents):
        spread = 0.5 * np.exp(log_scales[p].max()) if p >= 0 else 2.0
        means[i] = (means[p] if p >= 0 else 0.0) + spread * rng.normal(size=3)
        log_scales[i] = (log_scales[p] - 0.6 if p >= 0 else -0.5) + rng.normal(0, 0.5, 3)
    means = means.astype(np.float32)
    extents = 3 * np.exp(log_scales.max(axis=1, initial=-np.inf))
    for i in reversed(range(n)):
        if (p := parents[i]) >= 0:
            # A little more than needed, so that rounding to float32 keeps the balls nested.
            reach = extents[i] + np.linalg.norm(means[i].astype(np.float64) - means[p])
            extents[p] = max(extents[p], 1.0001 * reach)
    rest = (rng.normal(size=(n, 4)), log_scales, rng.normal(0, 3, n), np.zeros((n, 1, 3)))
    gaussians = Gaussians(means, *(column.astype(np.float32) for column in rest))
    return Scene(gaussians, tree_of(parents, extents.astype(np.float32)))


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Views from far, near, inside, looking away, and of one pixel."""
    rng = np.random.default_rng(draw(st.integers(0, 2**20)))
    direction = rng.normal(size=3)
    position = direction / np.linalg.norm(direction) * draw(st.sampled_from([0.01, 1.0, 5.0, 30.0]))
    target = draw(st.sampled_from([np.zeros(3), np.zeros(3), 3 * position, rng.normal(size=3)]))
    width, height = draw(st.sampled_from([(96, 64), (300, 200), (1, 1), (33, 500)]))
    fov = draw(st.sampled_from([20.0, 60.0, 120.0]))
    return Camera.look_at(position, target, width=width, height=height, fov_y_deg=fov)


def ancestors(parents: list[int], row: int) -> list[int]:
    found = []
    while (row := parents[row]) >= 0:
        found.append(row)
    return found


def cut_as_defined(parents: list[int], radii: np.ndarray, tau: float) -> list[int]:
    rows = range(len(parents))
    leaf = [v not in parents for v in rows]
    stops = [not leaf[v] and radii[v] <= tau for v in rows]
    return [v for v in rows if (leaf[v] or radii[v] <= tau) and not any(stops[u] for u in ancestors(parents, v))]


@st.composite
def forests_with_radii(draw: st.DrawFn) -> tuple[list[int], np.ndarray]:
    parents = draw(forests())
    values = st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 5.0, np.inf])
    return parents, np.array(draw(st.lists(values, min_size=len(parents), max_size=len(parents))), np.float64)


@given(forests_with_radii(), taus)
def test_cut_is_the_defined_set_by_prefix_maximum_and_by_walk(forest, tau):
    parents, radii = forest
    wanted = cut_as_defined(parents, radii, tau)
    assert reference.cut_rows(tree_of(parents), radii, tau).tolist() == wanted
    assert reference.cut_by_walk(tree_of(parents), radii, tau).tolist() == wanted


@given(forests_with_radii(), taus)
def test_each_leaf_has_exactly_one_member_on_its_path(forest, tau):
    # Coverage and, since two related members would share the leaves of the lower one, antichain.
    parents, radii = forest
    tree = tree_of(parents)
    rows = reference.cut_rows(tree, radii, tau)
    for leaf in np.flatnonzero(tree.is_leaf).tolist():
        assert len(set(rows.tolist()).intersection([leaf, *ancestors(parents, leaf)])) == 1
    assert count_nested(tree, rows) == 0


@given(forests_with_radii())
def test_tau_of_zero_gives_the_leaves_and_infinity_the_roots(forest):
    parents, radii = forest
    tree = tree_of(parents)
    assert reference.cut_rows(tree, radii + 1e-9, 0.0).tolist() == np.flatnonzero(tree.is_leaf).tolist()
    assert reference.cut_rows(tree, radii, np.inf).tolist() == [v for v, p in enumerate(parents) if p < 0]


@given(forests_with_radii(), taus, taus)
def test_coarser_cuts_are_above_finer_ones(forest, tau1, tau2):
    parents, radii = forest
    tree = tree_of(parents)
    fine, coarse = (set(reference.cut_rows(tree, radii, t).tolist()) for t in sorted([tau1, tau2]))
    assert all(len(coarse.intersection([v, *ancestors(parents, v)])) == 1 for v in fine)
    assert coarse <= {u for v in fine for u in [v, *ancestors(parents, v)]}


@given(forests_with_radii(), taus, st.integers(0, 2**20))
def test_cut_follows_a_permutation_of_siblings_and_roots(forest, tau, seed):
    parents, radii = forest
    order, moved = shuffled(parents, seed)
    there = reference.cut_rows(tree_of(moved), radii[order], tau)
    assert sorted(order[i] for i in there) == reference.cut_rows(tree_of(parents), radii, tau).tolist()


def shuffled(parents: list[int], seed: int) -> tuple[list[int], list[int]]:
    """Another preorder of the same forest: the old row of each new row, and its parents."""
    rng = np.random.default_rng(seed)
    children: dict[int, list[int]] = {}
    for v, p in enumerate(parents):
        children.setdefault(p, []).append(v)
    order: list[int] = []
    stack = [int(v) for v in rng.permutation(children.get(-1, []))]
    while stack:
        order.append(v := stack.pop())
        stack.extend(int(c) for c in rng.permutation(children.get(v, [])))
    place = {v: i for i, v in enumerate(order)}
    return order, [place[parents[v]] if parents[v] >= 0 else -1 for v in order]


@given(forests(), cameras(), taus, st.integers(0, 2**20))
def test_sphere_is_monotone_so_that_the_parent_alone_decides(parents, camera, tau, seed):
    scene = scene_of(parents, seed)
    radii = reference.radii(scene.gaussians, scene.tree.extents, camera, "sphere", 0.3)
    leaf = scene.tree.is_leaf
    assert all(p < 0 or radii[v] <= radii[p] for v, p in enumerate(parents))
    by_parent = [v for v, p in enumerate(parents) if (leaf[v] or radii[v] <= tau) and not (p >= 0 and radii[p] <= tau)]
    assert reference.cut_rows(scene.tree, radii, tau).tolist() == by_parent


@given(forests(), cameras(), st.sampled_from(PROFILES), taus, st.integers(0, 2**20))
def test_level_by_level_traversal_finds_the_same_cut(parents, camera, profile, tau, seed):
    scene = scene_of(parents, seed)
    options = SelectOptions(pixel_error=tau, profile=profile)
    rows, visited = select_serial(scene.gaussians, scene.tree, None, view_of(scene, camera), options)
    assert rows.tolist() == select(scene, camera, options).rows.tolist()
    assert visited <= len(scene)


@given(forests())
def test_levels_list_the_children_of_each_node(parents):
    table = child_table_of(tree_of(parents))
    lists = [[c for c, p in enumerate(parents) if p == v] for v in range(len(parents))]
    assert [table.children(np.array([v])).tolist() for v in range(len(parents))] == lists
    assert table.children(np.arange(len(parents))).tolist() == [c for found in lists for c in found]


@given(forests(), cameras(), taus, st.integers(0, 2**20))
def test_release_draws_what_paper_strict_draws_and_small_nodes_below(parents, camera, tau, seed):
    scene = scene_of(parents, seed)
    strict, release = (
        select(scene, camera, SelectOptions(pixel_error=tau, rule=rule, profile="ref", view_test="centre")).rows
        for rule in ("paper-strict", "release")
    )
    extra = np.setdiff1d(release, strict)
    assert np.isin(strict, release).all()
    assert not scene.tree.is_leaf[extra].any()
    assert count_nested(scene.tree, release) >= len(extra)
    assert count_nested(scene.tree, strict) == 0


def test_release_counts_its_duplicates():
    # A root, two children that are small too, and leaves: the inner nodes are all drawn, the leaves are not.
    scene = scene_of([-1, 0, 1, 1, 0, 4, 4], seed=1)
    camera = Camera.look_at(np.array([0.0, 0.0, -1000.0]), np.zeros(3))
    options = SelectOptions(pixel_error=50.0, rule="release", view_test="centre")
    rows = select(scene, camera, options).rows
    assert rows.tolist() == [0, 1, 4]
    assert count_nested(scene.tree, rows) == 2
    assert select(scene, camera, replace(options, rule="cut")).rows.tolist() == [0]


@pytest.mark.parametrize("profile", PROFILES)
@given(parents=forests(), camera=cameras(), seed=st.integers(0, 2**20))
def test_nodes_at_or_behind_the_near_plane_are_refined(profile, parents, camera, seed):
    scene = scene_of(parents, seed)
    radii = reference.radii(scene.gaussians, scene.tree.extents, camera, profile, 0.3)
    depths = reference.project(scene.gaussians, camera).depths
    assert not np.isnan(radii).any()
    if profile not in EXTENT_PROFILES:
        assert np.isinf(radii[depths <= camera.near]).all()
        assert np.isfinite(radii[depths > camera.near]).all()
