"""Trees that grow while they learn: children as the paper places them, parents that stay, and cuts as of any other tree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

import splatree as st
from splatree.lod.baselines import baseline, violations
from splatree.maths.rotations import matrices_from_quats
from splatree.scene.gradients import Moments
from splatree.train.densify import GROWN_UP, Rows, Sightings, densified
from splatree.train.lineage import CHILDREN, SHRINKING, Lineage, children_of

from ..scenes import cloud
from .conftest import views
from .test_run import bits

EXTENT = 100.0
OPTIONS = st.TrainOptions(iterations=330, max_gaussians=400, held_out=4, levels="grow")


def rows_of(n, seed=0, steps=GROWN_UP):
    gaussians = cloud(n, seed, degree=1, logits=("uniform", 0, 3))
    moments = Moments.zeros(n, 4)
    moments.steps[:] = steps
    return Rows(gaussians, moments, Lineage.none(gaussians))


def grown(rounds, n=40, seed=0):
    """Rows after some births, the scene's Gaussians before each of them, and a generator that goes on."""
    rows, rng, before = rows_of(n, seed), np.random.default_rng(seed), []
    for _ in range(rounds):
        before.append(rows.gaussians)
        count = len(rows.gaussians)
        weights = rng.choice([0.01, 10, 10, 10], count).astype(np.float32)  # a quarter is hidden, and goes
        rows = densified(rows, Sightings(rng.random(count), weights), count + 30, EXTENT, rng)
        rows.moments.steps[:] = GROWN_UP
    return rows, before


@given(seed=some.integers(0, 99))
def test_children_stand_at_half_a_sigma_along_the_two_longest_axes(seed):
    parents = cloud(20, seed, degree=1)
    children = children_of(parents)
    assert len(children) == CHILDREN
    axes, scales = matrices_from_quats(parents.quats), parents.scales().astype(float)
    for child in children:
        offset = np.einsum("nji,nj->ni", axes, child.means.astype(float) - parents.means) / scales
        along = np.sort(np.abs(offset), axis=1)
        # one rounding of float32 in means of order 1, over scales of 0.01 and more
        np.testing.assert_allclose(along, np.tile([0, 0.5, 0.5], (20, 1)), atol=1e-4)
        assert (np.abs(offset)[np.arange(20), np.argmin(scales, axis=1)] < 1e-4).all()
        np.testing.assert_allclose(child.scales(), SHRINKING * parents.scales(), rtol=1e-6)
        for name in ("quats", "logit_opacities", "sh"):
            np.testing.assert_array_equal(getattr(child, name), getattr(parents, name))
    middle = np.mean([child.means.astype(float) for child in children], axis=0)
    np.testing.assert_allclose(middle, parents.means, atol=1e-6)


def test_births_are_exact_and_only_grown_up_rows_have_children():
    rows = rows_of(100)
    seen = Sightings(np.linspace(1, 2, 100), np.full(100, 10, np.float32))
    assert len(densified(rows, seen, 131, EXTENT, np.random.default_rng(0)).gaussians) == 130  # ten times three more
    young = rows_of(100, steps=GROWN_UP - 1)
    assert len(densified(young, seen, 131, EXTENT, np.random.default_rng(0)).gaussians) == 100


@pytest.mark.parametrize("rounds", [0, 1, 4])
def test_the_tree_holds_what_learned_and_what_it_came_from(rounds):
    rows, before = grown(rounds)
    scene = rows.lineage.tree(st.Scene.flat(rows.gaussians))
    tree, g = scene.tree, scene.gaussians
    leaf = tree.is_leaf

    def means(of):
        return {tuple(mean) for mean in of}

    assert means(g.means[leaf]) == means(rows.gaussians.means) and leaf.sum() == len(rows.gaussians)
    assert means(g.means[~leaf]) <= set().union(*(means(of.means) for of in before))
    parent = parents_of(tree)
    child = np.flatnonzero(parent >= 0)
    np.testing.assert_allclose(g.scales()[child], SHRINKING * g.scales()[parent[child]], rtol=1e-6)
    apart = np.linalg.norm(g.means[child].astype(float) - g.means[parent[child]], axis=1)
    assert (apart + tree.extents[child] <= tree.extents[parent[child]] * (1 + 1e-6)).all()
    assert (rounds == 0) == (tree.num_levels == 1) and (tree.record is None) == (rounds == 0)
    assert len(set(scene.ids.tolist() if scene.ids is not None else range(len(scene)))) == len(scene)


def parents_of(tree):
    """Parent of each row, −1 for roots, by a walk."""
    parent, path = np.full(len(tree), -1), []
    for row, end in enumerate(tree.subtree_end):
        while path and path[-1][1] <= row:
            path.pop()
        if path:
            parent[row] = path[-1][0]
        path.append((row, end))
    return parent


def test_parents_that_lost_all_children_are_gone():
    rows, _ = grown(3)
    keep = np.flatnonzero(rows.lineage.of_rows < 0)  # roots that never had children
    scene = rows.take(keep).lineage.tree(st.Scene.flat(rows.gaussians.take(keep)))
    assert len(scene) == len(keep) and scene.tree.num_levels == 1


def test_published_methods_choose_from_it():
    rows, _ = grown(4)
    scene = rows.lineage.tree(st.Scene.flat(rows.gaussians))
    camera = views(1)[0]
    exact = st.select(scene, camera, st.SelectOptions(pixel_error=3)).rows
    for method in ("filtergs", "serial"):
        cut = baseline(method, scene, [camera]).cut(camera)
        found = violations(scene.tree, cut)
        assert found.duplicates == found.uncovered == 0
        assert set(exact) <= set(cut) and 0 < len(cut) < scene.tree.num_leaves


@pytest.fixture(scope="module")
def whole(kept_photographs):
    """A run that was not stopped."""
    return st.train(kept_photographs, OPTIONS)


def test_a_run_grows_a_tree_with_the_same_bits_after_a_stop(whole, photographs, tmp_path):
    scene = whole.scene
    assert scene.tree.record.rule == "grown" and scene.tree.record.profile == "exact"
    assert scene.tree.num_levels > 1 and scene.tree.num_leaves == whole.history[-1].num_gaussians <= 400
    files = st.RunFiles(tmp_path / "a.run")
    steps = iter(range(230, -1, -1))
    st.train(photographs, OPTIONS, files=files, stop=lambda: next(steps) == 0)
    again = st.train(photographs, OPTIONS, files=st.RunFiles(tmp_path / "a.run", resume=True))
    assert bits(again) == bits(whole) and (again.scene.tree.subtree_end == scene.tree.subtree_end).all()
    st.write(scene, tmp_path / "grown.splatree")
    assert st.read(tmp_path / "grown.splatree").tree.record == scene.tree.record


def test_refinement_takes_it(whole):
    scene = whole.scene
    refined = st.refine(scene, st.RefineOptions(iterations=20, made_views=8))
    assert refined.gain >= 0 and len(refined.scene) == len(scene)
