"""The search of a budget that begins at the τ_R of the view before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree.errors import InputError
from splatree.lod.budget import LARGEST_LIMIT, NEXT_SHARE, fill_budget, least_limit, meet_budget_from
from splatree.lod.select import count_nested, select
from splatree.render.build import build_lod
from splatree.scene.cameras import Camera
from splatree.scene.frame import CutRange
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

CAMERA = Camera.look_at([0, 0, -3], [0, 0, 0], width=64, height=48)


def surface(scale, num_roots=1):
    """The number of nodes of a surface, as τ_R decides it; counts the cuts that are asked for."""

    def rows_at(tau):
        rows_at.asked.append(tau)
        num = num_roots if np.isinf(tau) else max(num_roots, int(scale / max(tau, 0.01) ** 2))
        return np.zeros(min(num, 3_000_000), np.int8), num

    rows_at.asked = []
    return rows_at


@given(scale=st.floats(1e2, 3e5), budget=st.integers(1_000, 100_000), finest=st.floats(0, 3), last=st.floats(0.01, 1e5))
def test_any_start_meets_the_budget_and_nearly_fills_it(scale, budget, finest, last):
    rows, _, tau = meet_budget_from(surface(scale), budget, (finest, 0.0), last, CAMERA)
    assert len(rows) <= budget
    assert tau >= finest
    if tau > finest:
        assert len(rows) >= NEXT_SHARE * budget * 0.99


def test_a_start_that_fits_takes_one_cut_and_a_start_nearby_two():
    met = surface(1e6)
    _, _, tau = meet_budget_from(met, 10_000, (1.0, 0.0), 10.2, CAMERA)
    assert (met.asked, tau) == ([10.2], 10.2)
    for last in (9.5, 11.5):
        near = surface(1e6)
        meet_budget_from(near, 10_000, (1.0, 0.0), last, CAMERA)
        assert len(near.asked) == 2


def test_room_for_everything_ends_at_the_finest():
    rows, _, tau = meet_budget_from(surface(10), 2_000_000, (0.0, 1.6), 500.0, CAMERA)
    assert (len(rows), tau) == (100_000, 0.0)


def test_more_roots_than_the_budget_is_an_error():
    with pytest.raises(InputError, match="found 500 roots in view"):
        meet_budget_from(surface(1e4, num_roots=500), 100, (1.0, 0.0), 5.0, CAMERA)


def cube(seed: int) -> Scene:
    """3,000 small Gaussians anywhere in a cube."""
    n = 3000
    means = np.random.default_rng(seed).uniform(-1, 1, (n, 3)).astype(np.float32)
    quats, log_scales = np.tile(np.float32([1, 0, 0, 0]), (n, 1)), np.full((n, 3), -4, np.float32)
    return Scene.flat(Gaussians(means, quats, log_scales, np.zeros(n, np.float32), np.zeros((n, 1, 3), np.float32)))


def test_select_begins_at_the_last_view():
    scene = build_lod(cube(seed=3))
    options = SelectOptions(pixel_error=1.0, budget=400)
    alone = select(scene, CAMERA, options)
    for last in (alone.pixel_error, 0.5 * alone.pixel_error, 3 * alone.pixel_error, np.inf):
        moving = select(scene, CAMERA, options, last=last)
        assert 0.7 * 400 <= len(moving) <= 400  # steps of the tree are coarse in so small a scene
        assert count_nested(scene.tree, moving.rows) == 0
    unchanged = select(scene, CAMERA, options, last=alone.pixel_error)
    np.testing.assert_array_equal(unchanged.rows, alone.rows)


def forest(seed, num_trees=400, num_alone=0):
    """Sizes of nodes that enter and leave as those of a tree: a root above two inner nodes above two leaves each.

    Of `num_alone` further trees a root alone is in view: it comes, and nothing goes for it.
    """
    rng = np.random.default_rng(seed)
    root = rng.lognormal(4, 1, num_trees)
    inner = root[:, None] * rng.uniform(0.05, 0.9, (num_trees, 2))
    enters = np.column_stack([root, inner, np.zeros((num_trees, 4))]).astype(np.float32)
    leaves = np.column_stack([np.full(num_trees, 3e38), root, root, inner.repeat(2, axis=1)]).astype(np.float32)
    alone = np.full((num_alone, 7), 3e38, np.float32)  # never, but for the first of each
    alone[:, 0] = rng.lognormal(3, 1, num_alone)
    return np.concatenate([enters, alone]), np.concatenate([leaves, np.full_like(alone, 3e38)])


def range_of(enters, leaves):
    """The cuts of a forest: for `fill_budget`."""

    def range_at(finest, coarsest, every=1):
        range_at.asked.append((finest, coarsest, every))
        fine, coarse = (np.float32((tau / 3) ** 2) for tau in (finest, coarsest))
        some = slice(None, None, every)
        e, v = enters[some].ravel().copy(), leaves[some].ravel().copy()
        e[e <= fine] = 0
        is_drawn = (e <= coarse) & (v > fine)
        v[v > coarse] = 3.4e38
        return CutRange(np.flatnonzero(is_drawn).astype(np.int32), e[is_drawn], v[is_drawn])

    range_at.asked = []
    return range_at


@given(seed=st.integers(0, 99), budget=st.integers(400, 1700), finest=st.sampled_from([0.0, 1.0, 30.0]))
def test_the_finest_cut_within_a_budget_does_not_depend_on_the_guess(seed, budget, finest):
    enters, leaves = forest(seed)

    def count_at(tau):
        limit = np.float32((tau / 3) ** 2)
        return int(((np.where(enters <= limit, 0, enters) <= limit) & (leaves > limit)).sum())

    options = SelectOptions(budget=budget, profile="exact")
    found = [fill_budget(range_of(enters, leaves), None, options, finest, CAMERA, every=every) for every in (1, 4, 40)]
    for rows, _, tau in found:
        assert len(rows) == count_at(tau) <= budget
        assert tau == finest or count_at(tau * (1 - 1e-6)) > budget
        assert tau == found[0][2]
        np.testing.assert_array_equal(enters.ravel()[rows], enters.ravel()[found[0][0]])


@given(
    seed=st.integers(0, 99),
    budget=st.integers(400, 1700),
    finest=st.sampled_from([0.0, 1.0, 30.0]),
    aside=st.floats(0.2, 5) | st.floats(0.9, 1.1),
)
def test_where_a_budget_is_looked_for_first_changes_nothing(seed, budget, finest, aside):
    options = SelectOptions(budget=budget, profile="exact")
    wanted, _, tau = fill_budget(range_of(*forest(seed)), None, options, finest, CAMERA, every=4)
    rows, _, found = fill_budget(range_of(*forest(seed)), None, options, finest, CAMERA, every=4, near=aside * tau)
    assert found == tau
    np.testing.assert_array_equal(rows, wanted)


@pytest.mark.parametrize("budget", [800, 1000, 1300])
def test_what_comes_into_view_just_beyond_is_not_overlooked(budget):
    """Where roots come that nothing goes for, a coarser cut may have more nodes: the budget is then exceeded again."""
    options = SelectOptions(budget=budget, profile="exact")
    for seed in range(12):
        trees = forest(seed, num_alone=300)
        wanted = fill_budget(range_of(*trees), None, options, 0.0, CAMERA, every=4)[2]
        for aside in np.linspace(0.85, 0.91, 25):
            found = fill_budget(range_of(*trees), None, options, 0.0, CAMERA, every=4, near=aside * wanted)[2]
            assert found == wanted


def test_a_budget_is_met_in_one_pass_near_the_last():
    range_at, options = range_of(*forest(1)), SelectOptions(budget=1000, profile="exact")
    tau = fill_budget(range_at, None, options, 0.0, CAMERA, every=4)[2]
    assert len(range_at.asked) > 1
    range_at.asked.clear()
    assert fill_budget(range_at, None, options, 0.0, CAMERA, every=4, near=1.005 * tau)[2] == tau
    assert [every for *_, every in range_at.asked] == [1]


@pytest.mark.parametrize("num_roots", [390, 400])
def test_what_no_finite_limit_draws_is_left_to_the_roots(num_roots):
    enters, leaves = forest(1)
    options = SelectOptions(budget=399, profile="exact")

    def met():
        def rows_at(tau):
            assert tau == np.inf
            return np.zeros(num_roots, np.int32), 1

        return fill_budget(range_of(enters, leaves), rows_at, options, 1.0, CAMERA, every=4)

    if num_roots > 399:
        with pytest.raises(InputError, match="found 400 roots in view"):
            met()
    else:
        assert met()[2] == np.inf


def test_nodes_of_one_size_are_exchanged_together():
    rows = np.arange(4, dtype=np.int32)
    enters, leaves = np.float32([0, 0, 0, 5]), np.float32([5, 5, LARGEST_LIMIT, LARGEST_LIMIT])
    found = CutRange(rows, enters, leaves)
    assert [least_limit(found, budget) for budget in (1, 2, 3)] == [None, 5.0, 0.0]
    np.testing.assert_array_equal(found.at(5.0), [2, 3])


def test_a_budget_is_filled_and_its_cut_is_the_cut_of_its_pixel_error():
    scene = build_lod(cube(seed=5))
    for budget in (100, 300, 700):
        met = select(scene, CAMERA, SelectOptions(pixel_error=1.0, budget=budget))
        alone = select(scene, CAMERA, SelectOptions(pixel_error=met.pixel_error))
        np.testing.assert_array_equal(met.rows, alone.rows)
        finer = select(scene, CAMERA, SelectOptions(pixel_error=met.pixel_error * (1 - 1e-6)))
        assert len(met) <= budget < len(finer)
