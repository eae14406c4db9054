from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree import Gaussians, InputError, MergeOptions, Scene, ThinOptions, thin
from splatree.kernels.cpu.build import pairs
from splatree.kernels.cpu.build.partners import Partners
from splatree.kernels.reference import pairs as reference
from splatree.simplify.merge import weights_of

from .. import scenes

cloud = partial(scenes.cloud, log_scales=("normal", -2.0, 1.0), logits=("normal", 0.0, 2.0))


@pytest.mark.parametrize("n", [2, 3, 9, 60])
@pytest.mark.parametrize("dilation", [0.0, 0.01])
@pytest.mark.parametrize("spread", [0.0, 0.1, 3.0])
@pytest.mark.parametrize("hidden", [False, True])
def test_partners_agree_with_the_reference(n, dilation, spread, hidden, isa):
    g = cloud(n, seed=n, spread=spread)
    rng = np.random.default_rng(1)
    weights = rng.uniform(0.1, 1, n).astype(np.float32)
    visibilities = rng.uniform(0.05, 1, n).astype(np.float32) if hidden else np.ones(n, np.float32)
    if spread == 0:  # which of more than 8 at one place are candidates is left open
        n = min(n, 9)
        g, weights, visibilities = g.take(np.arange(n)), weights[:n], visibilities[:n]
    partner, costs, opacities = pairs.best_partners(g, weights, visibilities if hidden else None, dilation=dilation)
    expected = reference.best_partners(g, weights, visibilities, dilation=dilation)
    found, alphas = reference.pair_costs(g, weights, np.arange(n), partner, visibilities, dilation=dilation)
    # Float32 sums of terms of the size of what the two show, of which little may be left; exponentials are good to 1e-6.
    alpha = 1 / (1 + np.exp(-g.logit_opacities.astype(np.float64)))
    energy = alpha**2 * np.exp(2 * g.log_scales.max(axis=1)) * 40 + 40 * dilation
    rounding = 1e-5 * (energy + energy[partner])
    np.testing.assert_array_less(np.abs(costs - found), rounding)
    np.testing.assert_array_less(found - expected[1], 2 * rounding)  # no candidate was cheaper
    np.testing.assert_allclose(opacities, alphas, rtol=1e-4)


@pytest.mark.parametrize("order", ["any", "sorted", "few places", "one line"])
def test_candidates_are_the_nearest_however_the_points_stand(order, isa):
    n = 1500
    means = np.random.default_rng(3).normal(size=(n, 3)).astype(np.float32)
    if order == "sorted":
        means = means[np.argsort(means[:, 0])]
    if order == "few places":
        means = np.round(means)
    if order == "one line":
        means[:, 1:] = 0
    partners = Partners.unknown(n)
    partners.search(means, threads=2)
    apart = np.sum((means[:, None] - means[None]) ** 2, axis=2)
    np.fill_diagonal(apart, np.inf)
    found = np.take_along_axis(apart, partners.neighbors.astype(np.int64), axis=1)
    np.testing.assert_allclose(found, np.sort(apart, axis=1)[:, :8], rtol=1e-5)
    assert all(len(set(row)) == 8 for row in partners.neighbors)


@given(st.integers(1, 50), st.integers(0, 2**32 - 1), st.integers(0, 30))
def test_matching_takes_the_cheapest_pairs_that_share_no_row(n, seed, most):
    rng = np.random.default_rng(seed)
    partner = rng.integers(0, n, n).astype(np.int32)
    partner = np.where(partner == np.arange(n), (partner + 1) % n if n > 1 else -1, partner).astype(np.int32)
    costs = rng.integers(0, 5, n).astype(np.float32)
    representative = np.arange(n)
    free = np.ones(n, bool)
    made = 0
    for i in np.lexsort((np.arange(n), costs)):
        j = partner[i]
        if made < most and j >= 0 and free[i] and free[j]:
            free[[i, j]] = False
            representative[[i, j]] = i
            made += 1
    np.testing.assert_array_equal(pairs.match_pairs(partner, costs, most), representative)


@pytest.mark.parametrize("count", [1, 7, 100, 299, 300, 400])
def test_a_count_is_met_exactly_and_groups_hold_each_row_once(count):
    g = cloud(300, seed=3, degree=1)
    thinned = thin(Scene.flat(g, mode="antialiased"), ThinOptions(count=count))
    groups = thinned.groups
    assert len(thinned) == len(groups) == min(count, 300)
    np.testing.assert_array_equal(np.sort(groups.rows), np.arange(300))
    assert np.all(np.diff(groups.representatives) > 0)
    np.testing.assert_array_equal(groups.group_from_row[groups.representatives], np.arange(len(groups)))
    if count >= 300:
        np.testing.assert_array_equal(thinned.scene.gaussians.sh, g.sh)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_result_does_not_depend_on_threads(mode):
    g = cloud(3000, seed=4)
    results = [thin(Scene.flat(g, mode=mode), ThinOptions(keep=0.3), threads=t).scene.gaussians for t in (1, 2, 4)]
    for other in results[1:]:
        for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
            np.testing.assert_array_equal(getattr(results[0], name), getattr(other, name))


def test_twins_merge_first_and_cost_nothing():
    g = cloud(50, seed=5, spread=10.0)
    g = Gaussians(
        *(np.concatenate([c, c]) for c in (g.means, g.quats, g.log_scales, np.full(50, -3, np.float32), g.sh))
    )
    thinned = thin(Scene.flat(g, mode="antialiased"), ThinOptions(count=50))
    np.testing.assert_array_equal(thinned.groups.group_from_row[:50], thinned.groups.group_from_row[50:])
    np.testing.assert_allclose(
        thinned.scene.gaussians.means[thinned.groups.group_from_row[:50]], g.means[:50], rtol=1e-6
    )


def test_of_two_pairs_the_one_that_shows_less_merges():
    """Two neighbours of one colour are merged before two of different colours at the same distance."""
    colors = np.array([[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    g = Gaussians(
        np.array([[0, 0, 0], [0.1, 0, 0], [5, 0, 0], [5.1, 0, 0]], np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (4, 1)),
        np.full((4, 3), -2, np.float32),
        np.zeros(4, np.float32),
        colors[:, None, :],
    )
    groups = thin(Scene.flat(g, mode="classic"), ThinOptions(count=3)).groups
    np.testing.assert_array_equal(groups.group_from_row, [0, 0, 1, 2])


def test_all_at_one_place_become_one():
    g = cloud(40, seed=6, spread=0.0)
    for mode in ("classic", "antialiased"):
        thinned = thin(Scene.flat(g, mode=mode), ThinOptions(count=1))
        merged = thinned.scene.gaussians
        assert len(merged) == 1 and len(thinned.groups.rows) == 40
        assert np.isfinite(merged.log_scales).all() and np.isfinite(merged.logit_opacities).all()


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_enormous_scales_merge_to_finite_numbers(mode):
    g = cloud(50, seed=9)
    wide = Gaussians(g.means, g.quats, np.full_like(g.log_scales, 80.0), g.logit_opacities, g.sh)
    merged = thin(Scene.flat(wide, mode=mode), ThinOptions(count=5)).scene.gaussians
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.isfinite(getattr(merged, name)).all(), name


def test_gaussians_out_of_reach_are_refused():
    g = cloud(4, seed=10)
    far = Gaussians(g.means * np.float32(1e25), g.quats, g.log_scales, g.logit_opacities, g.sh)
    with pytest.raises(InputError, match="so far apart"):
        thin(Scene.flat(far), ThinOptions(count=1))


def test_a_neighbour_whose_cost_float32_cannot_hold_is_passed_over():
    """The nearest of the first is 10¹⁷ times as large; it takes the farther one of its own size."""
    g = cloud(3, seed=11)
    means = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32)
    log_scales = np.repeat(np.array([[-20], [20], [-20]], np.float32), 3, axis=1)
    g = Gaussians(means, g.quats, log_scales, g.logit_opacities, g.sh)
    partner, costs, _ = pairs.best_partners(g, np.ones(3, np.float32), dilation=0.0)
    assert partner[0] == 2 and partner[2] == 0 and np.isfinite(costs).all()


def test_a_named_opacity_rule_is_kept():
    g = cloud(60, seed=7)
    options = ThinOptions(count=59, merge=MergeOptions(opacity="union"))
    thinned = thin(Scene.flat(g, mode="classic"), options)
    members = thinned.groups.rows[np.repeat(thinned.groups.sizes == 2, thinned.groups.sizes)]
    alphas = 1 / (1 + np.exp(-g.logit_opacities[members].astype(np.float64)))
    merged = thinned.scene.gaussians.logit_opacities[thinned.groups.sizes == 2][0]
    assert 1 / (1 + np.exp(-float(merged))) == pytest.approx(1 - np.prod(1 - alphas), rel=1e-6)


@pytest.mark.parametrize("opacity", [None, "fitted"])
def test_a_pair_gets_the_fitted_opacity_in_a_classic_scene(opacity):
    g = cloud(2, seed=12)
    options = ThinOptions(count=1, pixel_size=0.5, visibility=False, merge=MergeOptions(opacity=opacity))
    thinned = thin(Scene.flat(g, mode="classic"), options)
    _, alphas = reference.pair_costs(
        *(g, weights_of(g, "opacity"), np.array([0]), np.array([1])), dilation=0.3 * 0.5**2
    )
    # The kernel's float32 opacity, good to about 1e-6.
    assert 1 / (1 + np.exp(-float(thinned.scene.gaussians.logit_opacities[0]))) == pytest.approx(alphas[0], rel=1e-5)
    assert 1e-3 < alphas[0] < 0.99  # neither end of what is allowed


def test_options_say_what_was_done():
    g = cloud(20, seed=13)
    for mode, opacity, weight in (("classic", "fitted", "opacity"), ("antialiased", "optical", "opacity-area")):
        thinned = thin(Scene.flat(g, mode=mode), ThinOptions(count=5))
        assert thinned.options.method == "pairs"
        assert (thinned.options.merge.opacity, thinned.options.merge.weight) == (opacity, weight)
        again = thin(Scene.flat(g, mode=mode), thinned.options)
        np.testing.assert_array_equal(again.scene.gaussians.logit_opacities, thinned.scene.gaussians.logit_opacities)


def test_fitted_opacity_is_of_pairs_alone():
    with pytest.raises(InputError, match="only merging by pairs"):
        thin(Scene.flat(cloud(20, seed=14)), ThinOptions(radius=0.1, merge=MergeOptions(opacity="fitted")))


def test_cost_falls_with_the_square_of_the_visibility():
    g = cloud(9, seed=15)
    weights = np.ones(9, np.float32)
    seen = pairs.best_partners(g, weights, np.ones(9, np.float32), dilation=0.0)
    hidden = pairs.best_partners(g, weights, np.full(9, 0.25, np.float32), dilation=0.0)
    np.testing.assert_array_equal(hidden[0], seen[0])
    np.testing.assert_array_equal(hidden[1], seen[1] / 16)  # powers of two: exactly
    np.testing.assert_array_equal(hidden[2], seen[2])


def test_of_two_pairs_alike_the_hidden_one_merges():
    """Opaque balls stand around the second pair, in each direction that is looked along; larger, they cost more to merge."""
    around = [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x * y * z]
    means = np.concatenate([[[30, 0, 0], [30.05, 0, 0], [0, 0, 0], [0.05, 0, 0]], 3 * np.array(around)])
    n = len(means)
    small = np.arange(n) < 4
    g = Gaussians(
        means.astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.repeat(np.where(small, -3, 0), 3).reshape(n, 3).astype(np.float32),
        np.where(small, 0, 5).astype(np.float32),
        np.repeat(np.arange(n) % 2, 3).reshape(n, 1, 3).astype(np.float32),
    )
    groups = thin(Scene.flat(g, mode="classic"), ThinOptions(count=n - 1, pixel_size=1e-3)).groups
    np.testing.assert_array_equal(groups.rows[groups.start[:-1]][groups.sizes == 2], [2])
    alike = thin(Scene.flat(g, mode="classic"), ThinOptions(count=n - 1, pixel_size=1e-3, visibility=False)).groups
    np.testing.assert_array_equal(alike.rows[alike.start[:-1]][alike.sizes == 2], [0])


@pytest.mark.parametrize(
    "wrong",
    [{"method": "pairs"}, {"method": "pairs", "radius": 1.0}, {"method": "ball"}, {"keep": 0.5, "pixel_size": 0.0}],
)
def test_options_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match=r"method|pixel_size"):
        ThinOptions(**wrong)
