from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from splatree import Gaussians, InputError, Scene, ThinOptions, build_lod, thin
from splatree.kernels.cpu.build import thin as fast
from splatree.kernels.reference import thin as reference
from splatree.kernels.reference.pairs import energies, pair_costs
from splatree.scene.thinning import MergeLimit
from splatree.simplify.merge import importance_of
from splatree.simplify.thin import auto_radius

from ..scenes import cloud

FIELDS = ("representatives", "group_from_row", "start", "rows")


@st.composite
def points(draw):
    """Means, colours, importance: on lattices, so that ties, duplicates and distances of exactly r are common."""
    n = draw(st.integers(0, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    step = draw(st.sampled_from([0.0, 0.25, 0.5]))
    means = rng.normal(size=(n, 3))
    means = (np.round(means / step) * step if step else means).astype(np.float32)
    means *= draw(st.sampled_from([1.0, 1.0, 1000.0]))
    colors = (np.round(rng.random((n, 3)) * 4) / 4).astype(np.float32)
    importance = rng.choice([-1.0, 0.0, 0.5, 2.0], size=n).astype(np.float32)
    return means, colors, importance


@given(
    points(), st.sampled_from([0.0, 0.25, 0.5, 1.0, 3.0, 1e9]), st.sampled_from([0.35, 0.5, np.inf]), st.integers(1, 3)
)
def test_groups_are_those_of_the_sequential_greedy(data, radius, color_radius, threads):
    expected = reference.thin(*data, radius=radius, color_radius=color_radius)
    found = fast.thin(*data, radius=radius, color_radius=color_radius, threads=threads)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    count = fast.count_representatives(*data, radius=radius, color_radius=color_radius)
    assert count == len(expected)


@given(points(), st.sampled_from([0.0, 0.5, 1.0]), st.sampled_from([0.35, np.inf]))
def test_representatives_are_apart_and_members_near(data, radius, color_radius):
    means, colors, _ = data
    groups = fast.thin(*data, radius=radius, color_radius=color_radius)
    joint = means.astype(np.float64)
    if radius and np.isfinite(color_radius):
        joint = np.concatenate([joint, colors.astype(np.float64) * (radius / color_radius)], axis=1)
    rounding = 1e-12 * max(1.0, np.abs(joint).max(initial=0))  # of the float64 sums here, against those of the kernel
    centers = joint[groups.representatives]
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2) + np.diag(np.full(len(groups), np.inf))
    assert (apart > radius - rounding).all()
    near = np.linalg.norm(joint - centers[groups.group_from_row], axis=1)
    assert (near <= radius + rounding).all()


@given(points(), st.sampled_from([0.25, 1.0]))
def test_each_row_is_in_one_group(data, radius):
    groups = fast.thin(*data, radius=radius, color_radius=np.inf)
    np.testing.assert_array_equal(np.sort(groups.rows), np.arange(len(data[0])))
    np.testing.assert_array_equal(np.repeat(np.arange(len(groups)), groups.sizes), groups.group_from_row[groups.rows])
    np.testing.assert_array_equal(groups.group_from_row[groups.representatives], np.arange(len(groups)))


def test_groups_do_not_depend_on_the_order_of_rows():
    g = cloud(500)
    importance = importance_of(g, "opacity-scale")
    colors = np.zeros_like(g.means)
    order = np.random.default_rng(1).permutation(len(g))
    a = fast.thin(g.means, colors, importance, radius=0.4, color_radius=np.inf)
    b = fast.thin(g.means[order], colors, importance[order], radius=0.4, color_radius=np.inf)
    np.testing.assert_array_equal(np.sort(order[b.representatives]), a.representatives)
    representative_a = a.representatives[a.group_from_row]
    np.testing.assert_array_equal(order[b.representatives[b.group_from_row]], representative_a[order])


def test_rounds_and_visits_do_not_depend_on_threads():
    rng = np.random.default_rng(2)
    means = rng.uniform(0, 30, size=(60_000, 3)).astype(np.float32)
    means[:, 2] = 0
    colors, importance = np.zeros_like(means), rng.random(len(means)).astype(np.float32)
    a = fast.thin(means, colors, importance, radius=0.5, color_radius=np.inf, threads=1)
    b = fast.thin(means, colors, importance, radius=0.5, color_radius=np.inf, threads=2)
    for name in (*FIELDS, "rounds", "num_visited"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert 1 < a.rounds < 100


def test_far_outliers_share_cells_and_stay_apart():
    rng = np.random.default_rng(3)
    means = rng.normal(0, 0.05, size=(400, 3)).astype(np.float32)
    means[:8] = [[s * x, t * x, x] for s in (-1, 1) for t in (-1, 1) for x in (1200.0, 1e30)]
    data = means, np.zeros_like(means), rng.random(400).astype(np.float32)
    expected = reference.thin(*data, radius=0.01, color_radius=np.inf)
    found = fast.thin(*data, radius=0.01, color_radius=np.inf)
    np.testing.assert_array_equal(found.group_from_row, expected.group_from_row)


def test_identical_points_merge_at_radius_zero():
    g = cloud(1).take(np.zeros(5000, np.int64))
    thinned = thin(Scene.flat(g), ThinOptions(radius=0.0))
    assert len(thinned) == 1
    np.testing.assert_array_equal(thinned.scene.gaussians.means, g.means[:1])


def test_distinct_points_stay_bit_for_bit_at_radius_zero():
    g = cloud(300, degree=1)
    thinned = thin(Scene.flat(g), ThinOptions(radius=0.0))
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert getattr(thinned.scene.gaussians, name).tobytes() == getattr(g, name).tobytes()


def test_radius_beyond_the_scene_leaves_one():
    assert len(thin(Scene.flat(cloud(200)), ThinOptions(radius=1e9, color_radius=None))) == 1


@pytest.mark.parametrize("n", [0, 1])
def test_smallest_scenes(n):
    for options in (ThinOptions(), ThinOptions(keep=0.5), ThinOptions("radius", count=1), ThinOptions(radius=1.0)):
        assert len(thin(Scene.flat(cloud(n)), options)) == n


def test_enormous_scales_merge_to_finite_numbers():
    g = cloud(50)
    wide = Gaussians(g.means, g.quats, np.full_like(g.log_scales, 80.0), g.logit_opacities, g.sh)
    merged = thin(Scene.flat(wide), ThinOptions(radius=10.0)).scene.gaussians
    assert np.isfinite(merged.log_scales).all() and np.isfinite(merged.logit_opacities).all()


@pytest.mark.parametrize("keep", [0.5, 0.1])
def test_a_share_is_met_to_one_percent(keep):
    g = cloud(20_000)
    thinned = thin(Scene.flat(g), ThinOptions("radius", keep=keep, color_radius=None))
    assert abs(len(thinned) / (keep * len(g)) - 1) <= 0.01
    again = thin(Scene.flat(g), ThinOptions(radius=thinned.radius, color_radius=None))
    np.testing.assert_array_equal(again.groups.group_from_row, thinned.groups.group_from_row)


def test_count_that_colour_forbids_is_refused():
    g = cloud(200)
    with pytest.raises(InputError, match="color_radius"):
        thin(Scene.flat(g), ThinOptions("radius", count=1, color_radius=0.01))


def test_auto_radius_is_the_median_distance_to_the_nearest():
    g = cloud(1000)
    x = g.means.astype(np.float64)
    apart = np.linalg.norm(x[:, None] - x[None], axis=2) + np.diag(np.full(len(x), np.inf))
    # All rows are sampled; the distances are sums of the same squares in float64.
    assert auto_radius(g) == pytest.approx(1.5 * np.median(apart.min(axis=1)), rel=1e-12)


def test_auto_radius_of_a_line_is_one_and_a_half_steps():
    g = cloud(50)
    g.means[:] = 0
    g.means[:, 1] = np.arange(50) * 0.25
    assert auto_radius(g) == pytest.approx(1.5 * 0.25)


def test_auto_radius_looks_past_duplicates():
    g = cloud(300)
    assert auto_radius(Gaussians.concatenate([g, g])) > 0
    assert auto_radius(g.take(np.zeros(10, np.int64))) == 0


@pytest.mark.parametrize("field", ["means", "quats", "log_scales", "logit_opacities", "sh"])
def test_not_finite_rows_are_named(field):
    g = cloud(10)
    columns = {name: getattr(g, name).copy() for name in ("means", "quats", "log_scales", "logit_opacities", "sh")}
    columns[field].reshape(10, -1)[7, 0] = np.nan
    with pytest.raises(InputError, match=rf"{field}\[7\]"):
        thin(Scene.flat(Gaussians(**columns)))


def test_zero_quaternion_is_named():
    g = cloud(10)
    quats = g.quats.copy()
    quats[4] = 0
    with pytest.raises(InputError, match=r"quats\[4\]"):
        thin(Scene.flat(Gaussians(g.means, quats, g.log_scales, g.logit_opacities, g.sh)))


@pytest.mark.parametrize(
    "wrong",
    [
        {"radius": -1.0},
        {"radius": float("nan")},
        {"radius": 1.0, "keep": 0.5},
        {"keep": 0.0},
        {"keep": 1.5},
        {"count": 0},
        {"color_radius": 0.0},
    ],
)
def test_impossible_options_are_refused(wrong):
    with pytest.raises(InputError):
        ThinOptions(**wrong)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"method": "radius", "keep": 0.5, "visibility": False}, "visibility: found False, but the method 'radius'"),
        ({"radius": 1.0, "pixel_size": 0.1}, r"pixel_size: found 0\.1, but the method 'radius'"),
        ({"pixel_size": 0.1}, r"pixel_size: found 0\.1, but the method 'radius'"),
        (
            {"method": "pairs", "count": 9, "importance": "opacity"},
            "importance: found 'opacity', but the method 'pairs'",
        ),
        (
            {"keep": 0.5, "color_radius": None},
            r"color_radius: found None, .* wanted 0\.5; leave it out, or .* 'radius'",
        ),
    ],
)
def test_options_of_the_other_method_are_refused(given, found):
    with pytest.raises(InputError, match=found):
        ThinOptions(**given)


def test_a_scene_is_thinned_as_it_is_drawn_and_by_its_leaves():
    scene = replace(Scene.flat(cloud(400), mode="antialiased"), threshold=0.01, tile_rule="balanced")
    alone, tree = thin(scene, ThinOptions(keep=0.5)), build_lod(scene)
    found = thin(tree, ThinOptions(keep=0.5)).scene
    assert (found.mode, found.threshold, found.tile_rule) == ("antialiased", 0.01, "balanced")
    assert found.tree.num_leaves == len(found) == len(alone) and "levels" not in found.source.metadata


def test_what_is_no_scene_is_refused_with_what_to_do():
    with pytest.raises(InputError, match=r"found Gaussians, wanted a Scene; make one with Scene.flat\(gaussians"):
        thin(cloud(3))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [1, -1])
def test_points_exactly_a_radius_apart_are_found_however_their_cells_are_rounded(axis, side):
    """Where x / r is a whole number k, x · (1/r) may round to below k, and (x + r) · (1/r) to k + 1: with cells of edge r the
    two points would be two cells apart."""
    hard = [
        (r, k) for r in range(3, 400) for k in range(1, 60) if r * k * (1 / r) < k and r * (k + 1) * (1 / r) >= k + 1
    ]
    assert len(hard) > 50
    for r, k in hard[:: len(hard) // 50]:
        means = np.zeros((5, 3), np.float32)
        means[:, axis] = side * np.array(
            [-20 * r * k, 0, 0, r * k, r * (k + 1)]
        )  # the middle one is the lattice's origin
        colors, importance = np.zeros_like(means), np.arange(5, 0, -1, dtype=np.float32)
        found = fast.thin(means, colors, importance, radius=float(r), color_radius=np.inf)
        expected = reference.thin(means, colors, importance, radius=float(r), color_radius=np.inf)
        np.testing.assert_array_equal(found.group_from_row, expected.group_from_row)


@given(points(), st.sampled_from([0.0, 0.25, 0.5, 1.0]), st.sampled_from([0.35, np.inf]), st.integers(1, 3), st.data())
def test_certain_answers_are_those_of_the_reference_and_never_contradict_the_whole(
    data, radius, color_radius, threads, draw
):
    n, rule = len(data[0]), {"radius": radius, "color_radius": color_radius}
    rng = np.random.default_rng(draw.draw(st.integers(0, 2**32 - 1)))
    is_open = rng.random(n) < draw.draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))
    found = fast.certain(*data, is_open, **rule, threads=threads)
    np.testing.assert_array_equal(found, reference.certain(*data, is_open, **rule))
    groups = fast.thin(*data, **rule)
    whole = groups.representatives[groups.group_from_row]
    assert (found[is_open] == -1).all()
    assert (found[found >= 0] == whole[found >= 0]).all()
    if not is_open.any():
        np.testing.assert_array_equal(found, whole)
    more_open = is_open | (rng.random(n) < 0.2)
    less = fast.certain(*data, more_open, **rule)
    assert ((less == found) | (less == -1)).all()


@given(points(), st.sampled_from([0.25, 0.5, 1.0]), st.floats(-2, 2))
def test_what_is_certain_in_a_part_is_so_in_the_whole(data, radius, border):
    """Rows beyond a plane are left out; those nearer to it than r are open."""
    x = data[0][:, 0].astype(np.float64)
    here = np.flatnonzero(x <= border)
    part = [column[here] for column in data]
    found = fast.certain(*part, x[here] > border - radius, radius=radius, color_radius=np.inf)
    groups = fast.thin(*data, radius=radius, color_radius=np.inf)
    whole = groups.representatives[groups.group_from_row]
    is_known = found >= 0
    np.testing.assert_array_equal(here[found[is_known]], whole[here[is_known]])


@st.composite
def limits(draw):
    """Points, and a limit that no merge of two of them is near: the kernel computes costs in float32."""
    data = means, colors, _ = draw(points())
    n = len(means)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, faint = draw(st.sampled_from([(0.05, 0), (0.3, 0), (1.0, 0), (400.0, 0), (1.0, -14), (400.0, -14)]))
    size *= max(1.0, float(np.abs(means).max(initial=0)) / 3)
    log_scales = (np.log(size) + rng.normal(0, 0.7, (n, 3))).astype(np.float32)
    logits, quats = ((rng.normal(size=shape) + mean).astype(np.float32) for shape, mean in ((n, faint), ((n, 4), 0)))
    weights, visibilities = (rng.uniform(0.1, 1, n).astype(np.float32) for _ in range(2))
    gaussians = Gaussians(means, quats, log_scales, logits, colors[:, None])
    first, second = np.triu_indices(n, 1)
    costs = pair_costs(gaussians, weights, first, second, visibilities, dilation=0.0)[0]
    most = float(np.quantile(costs, draw(st.sampled_from([0.1, 0.4, 0.8])))) if len(costs) else 1.0
    most *= 1.003
    # A cost is a difference of what is shown, by a merged Gaussian with an opacity of 1e-4 at least: float32 is wrong by 1e-6
    # of that.
    largest = float(gaussians.opacities().max(initial=1e-4))
    shown = float(np.exp(2 * log_scales.astype(np.float64).max(initial=-30))) * 10 * largest**2
    assume((np.abs(costs - most) > 1e-3 * most + 1e-5 * shown).all())
    each = energies(gaussians, visibilities, dilation=0.0)
    left_out = 2 * (each[first] + each[second])[costs > most]
    assume((np.abs(left_out - most) > 1e-3 * most).all())  # a sum of positive terms, right to 1e-6
    return data, MergeLimit(gaussians, weights, visibilities, most)


@given(limits(), st.sampled_from([0.5, 1.0, 3.0, 1e9]), st.sampled_from([0.5, np.inf]), st.integers(1, 3), st.data())
def test_a_limit_gives_the_groups_of_the_reference_in_wholes_and_parts(
    data_and_limit, radius, color_radius, threads, draw
):
    data, limit = data_and_limit
    rule = {"radius": radius, "color_radius": color_radius, "limit": limit}
    expected, found = reference.thin(*data, **rule), fast.thin(*data, **rule, threads=threads)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    whole = found.representatives[found.group_from_row]
    rng = np.random.default_rng(draw.draw(st.integers(0, 2**32 - 1)))
    is_open = rng.random(len(whole)) < draw.draw(st.sampled_from([0.0, 0.1, 0.5]))
    certain = fast.certain(*data, is_open, **rule, threads=threads)
    np.testing.assert_array_equal(certain, reference.certain(*data, is_open, **rule))
    assert (certain[is_open] == -1).all() and (certain[certain >= 0] == whole[certain >= 0]).all()


def test_large_faint_gaussians_join_whatever_their_merged_opacity_is_raised_to():
    g = cloud(60)
    faint = Gaussians(g.means, g.quats, np.full_like(g.log_scales, 7), np.full_like(g.logit_opacities, -14), g.sh)
    ones = np.ones(60, np.float32)
    limit = MergeLimit(faint, ones, ones, 0.02)
    data = g.means, np.zeros_like(g.means), importance_of(g, "opacity-scale")
    for kernel in (reference, fast):
        assert len(kernel.thin(*data, radius=100.0, color_radius=np.inf, limit=limit)) == 1
    first, second = np.zeros(59, int), np.arange(1, 60)
    assert (pair_costs(faint, ones, first, second, ones, dilation=0.0)[0] > limit.most).all()


@given(limits(), st.sampled_from([0.5, 3.0]))
def test_members_join_within_the_limit_and_representatives_could_join_none(data_and_limit, radius):
    (means, colors, importance), limit = data_and_limit
    groups = fast.thin(means, colors, importance, radius=radius, color_radius=np.inf, limit=limit)
    joined = groups.representatives[groups.group_from_row]
    members = np.flatnonzero(joined != np.arange(len(means)))
    columns = limit.gaussians, limit.weights
    shown = energies(limit.gaussians, limit.visibilities, dilation=0.0)

    def costs(first, second):
        merged = pair_costs(*columns, first, second, limit.visibilities, dilation=0.0)[0]
        return np.minimum(merged, 2 * (shown[first] + shown[second]))  # of the merge, or of leaving both out

    assert (costs(members, joined[members]) <= limit.most).all()
    first, second = (index.ravel() for index in np.meshgrid(groups.representatives, groups.representatives))
    apart = np.linalg.norm(means[first].astype(np.float64) - means[second].astype(np.float64), axis=1)
    is_near = (first != second) & (apart < radius * (1 - 1e-6))
    assert (costs(first[is_near], second[is_near]) > limit.most).all()


def test_a_limit_of_infinity_changes_nothing():
    g = cloud(400)
    importance, ones = importance_of(g, "opacity-scale"), np.ones(400, np.float32)
    data, rule = (g.means, np.zeros_like(g.means), importance), {"radius": 0.4, "color_radius": np.inf}
    limited = fast.thin(*data, **rule, limit=MergeLimit(g, ones, ones, 1e38))
    np.testing.assert_array_equal(limited.group_from_row, fast.thin(*data, **rule).group_from_row)
