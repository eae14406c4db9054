import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree import Gaussians, MergeOptions, merge
from splatree.kernels.cpu.build import merge as fast
from splatree.kernels.cpu.build.thin import group
from splatree.kernels.reference import merge as reference
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.rotations import matrices_from_quats
from splatree.simplify.merge import weights_of

from ..scenes import gaussians

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")


@st.composite
def grouped(draw):
    """Gaussians of many shapes (flat, needle, aligned, duplicated), groups, weights."""
    n = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    quats = rng.normal(size=(n, 4)) if draw(st.booleans()) else np.tile([1.0, 0, 0, 0], (n, 1))
    log_scales = rng.normal(-2, draw(st.sampled_from([0.0, 1.0, 3.0])), size=(n, 3))
    gaussians = Gaussians(
        (rng.normal(size=(n, 3)) * draw(st.sampled_from([0.0, 0.1, 1.0]))).astype(np.float32),
        quats.astype(np.float32),
        log_scales.astype(np.float32),
        rng.normal(0, 3, size=n).astype(np.float32),
        rng.normal(size=(n, 4, 3)).astype(np.float32),
    )
    num_groups = draw(st.integers(1, n))
    first_of = rng.choice(n, num_groups, replace=False)
    representative = rng.choice(first_of, n)
    representative[first_of] = first_of
    return gaussians, group(representative.astype(np.int32)), rng.uniform(0.01, 1, n).astype(np.float32)


RULES = [
    MergeOptions(rule=rule, opacity=opacity, position=position, dilation=dilation, scale_bound=bound)
    for rule, opacity, position, (dilation, bound) in itertools.product(
        ("moments", "mean"),
        ("standard", "optical", "union", "mass"),
        ("centroid", "representative"),
        ((0.0, None), (0.3, 1.2)),
    )
]


@given(grouped(), st.sampled_from(RULES), st.sampled_from([0.0, 0.7]))
def test_merge_agrees_with_the_reference(data, options, added):
    expected, found = (merge(*data, options, added=added) for merge in (reference.merge, fast.merge))
    for name in ("means", "log_scales", "logit_opacities", "sh"):
        # Both compute in float64 and round to float32; an eigenvalue 1e-6 of the largest has 1e-10 of relative rounding.
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=2e-6, atol=2e-6, err_msg=name)
    # Axes of nearly equal length may turn; the shape may not.
    shapes = [covariances_from_gaussians(g.quats, g.log_scales) for g in (expected, found)]
    size = np.abs(shapes[0]).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(shapes[1] / size, shapes[0] / size, atol=2e-6)


@given(grouped())
def test_moments_keep_mean_and_covariance(data):
    gaussians, groups, weights = data
    merged = fast.merge(gaussians, groups, weights, MergeOptions(opacity="union"))
    covariances = covariances_from_gaussians(gaussians.quats, gaussians.log_scales)
    merged_covariances = covariances_from_gaussians(merged.quats, merged.log_scales)
    for g in range(len(groups)):
        rows = groups.rows[groups.start[g] : groups.start[g + 1]]
        w = weights[rows].astype(np.float64) / weights[rows].sum(dtype=np.float64)
        x = gaussians.means[rows].astype(np.float64)
        mean = w @ x
        expected = np.einsum("n,nij->ij", w, covariances[rows] + np.einsum("ni,nj->nij", x - mean, x - mean))
        # Float32 rounding of mean, quaternion and log-scales.
        np.testing.assert_allclose(merged.means[g], mean, atol=1e-6)
        np.testing.assert_allclose(merged_covariances[g], expected, atol=4e-6 * np.abs(expected).max())


@given(grouped(), st.sampled_from(["moments", "mean"]))
def test_rotations_are_proper_and_unit(data, rule):
    gaussians, groups, weights = data
    merged = fast.merge(gaussians, groups, weights, MergeOptions(rule=rule, opacity="union"))
    many = groups.sizes > 1
    # Float32 rounding of four numbers.
    np.testing.assert_allclose(np.linalg.norm(merged.quats[many], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(matrices_from_quats(merged.quats[many])), 1, atol=1e-6)


@given(grouped(), st.sampled_from(RULES))
def test_a_group_of_one_is_copied_bit_for_bit(data, options):
    gaussians, groups, weights = data
    merged = fast.merge(gaussians, groups, weights, options)
    single = np.flatnonzero(groups.sizes == 1)
    for name in NAMES:
        copied = getattr(gaussians, name)[groups.representatives[single]]
        assert getattr(merged, name)[single].tobytes() == copied.tobytes()


@given(grouped(), st.sampled_from(RULES))
def test_merge_does_not_depend_on_threads(data, options):
    one, two = (fast.merge(*data, options, threads=threads) for threads in (1, 2))
    for name in NAMES:
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def all_of(gaussians: Gaussians):
    return group(np.zeros(len(gaussians), np.int32))


def twins(offset: float, logit: float = 0.0) -> Gaussians:
    return Gaussians(
        np.array([[-offset, 0, 0], [offset, 0, 0]], np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (2, 1)),
        np.zeros((2, 3), np.float32),
        np.full(2, logit, np.float32),
        np.zeros((2, 1, 3), np.float32),
    )


def test_twins_at_one_place_are_one_of_their_shape():
    merged = merge(twins(0.0), all_of(twins(0.0)), MergeOptions(opacity="union"))
    np.testing.assert_allclose(merged.log_scales, 0, atol=1e-7)
    # 1 − ½·½ = ¾
    np.testing.assert_allclose(1 / (1 + np.exp(-merged.logit_opacities)), 0.75, rtol=1e-6)


def test_twins_side_by_side_stretch_along_their_line():
    merged = merge(twins(2.0), all_of(twins(2.0)), MergeOptions(opacity="union"))
    # σ² = 1 + 2² along x, the longest axis first.
    np.testing.assert_allclose(np.exp(2 * merged.log_scales[0]), [5, 1, 1], rtol=1e-6)


def test_mass_of_far_twins_is_spread_over_the_area():
    far = twins(1000.0, logit=2.0)
    alpha = 1 / (1 + np.exp(-2.0))
    merged = merge(far, all_of(far), MergeOptions(opacity="mass"))
    area = reference.mean_projected_area(np.exp(2 * merged.log_scales[0].astype(np.float64)))
    # α A = Σ α_i A_i, with A / π = 1 for unit spheres; float32 logit.
    assert area / (1 + np.exp(-merged.logit_opacities[0])) == pytest.approx(2 * alpha, rel=1e-5)


def test_excess_mass_widens_a_standard_merge():
    many = twins(0.0, logit=8.0)
    plain = merge(many, all_of(many), MergeOptions(opacity="union"))
    widened = merge(many, all_of(many), MergeOptions(opacity="standard", widening=0.4))
    # Two opaque ones at one place have the mass 2.
    np.testing.assert_allclose(widened.log_scales - plain.log_scales, 0.4 * np.log(2), rtol=1e-3)


def test_optical_depth_of_far_twins_is_kept():
    far = twins(1000.0, logit=2.0)
    merged = merge(far, all_of(far), MergeOptions(opacity="optical"))
    area = reference.mean_projected_area(np.exp(2 * merged.log_scales[0].astype(np.float64)))
    alphas = 1 / (1 + np.exp(-np.array([2.0, merged.logit_opacities[0]], np.float64)))
    before, after = (reference.dilogarithm(a) for a in alphas)
    assert after * area == pytest.approx(2 * before, rel=1e-5)  # float32 logit


def test_an_opaque_stack_widens_by_what_it_covers():
    stack = Gaussians.concatenate([twins(0.0, logit=8.0)] * 5)
    merged = merge(stack, all_of(stack), MergeOptions(opacity="optical"))
    depth = 10 * reference.dilogarithm(1 / (1 + np.exp(-8.0)))
    x = np.linspace(0, 60, 2_000_001)  # ∫ 1 − exp(−T e^−x) dx: rings of a Gaussian, in units of its area
    covered = [float(np.mean(-np.expm1(-t * np.exp(-x))) * 60) for t in (depth, reference.dilogarithm(0.999))]
    # The mean of two million samples has an error of about 1e-5.
    np.testing.assert_allclose(merged.log_scales, 0.5 * np.log(covered[0] / covered[1]), rtol=1e-4)


def test_mean_projected_area_is_within_its_bound():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for axes in ([1, 1, 1], [1, 1, 1e-4], [1, 1e-4, 1e-4], [1, 0.5, 0.1]):
        a, b, c = axes
        # The shadow along d is π sqrt(Σ (product of the other two axes)² d_i²).
        exact = np.sqrt(directions**2 @ np.square([b * c, a * c, a * b])).mean()
        # Thomsen's 1.061 % and 0.2 % of sampling noise.
        assert reference.mean_projected_area(np.square(axes)) == pytest.approx(exact, rel=0.0126)


def test_scale_bound_holds():
    g = twins(50.0)
    merged = merge(g, all_of(g), MergeOptions(rule="mean", opacity="union"))
    np.testing.assert_allclose(np.exp(merged.log_scales), 1.5, rtol=1e-6)


def test_invisible_gaussians_have_a_mean():
    g = twins(1.0, logit=-200.0)
    merged = merge(g, all_of(g))
    assert all(np.isfinite(getattr(merged, name)).all() for name in NAMES)


@pytest.mark.parametrize("rule", ["opacity", "opacity-scale", "opacity-area"])
def test_weights_are_relative_products(rule):
    g = twins(1.0)
    g = Gaussians(
        g.means, g.quats, np.array([[0, 1, 2], [3, 3, 3]], np.float32), np.array([0.0, 9.0], np.float32), g.sh
    )
    alphas = 1 / (1 + np.exp(-g.logit_opacities.astype(np.float64)))
    factor = {"opacity": [1, 1], "opacity-scale": np.exp([1, 3]), "opacity-area": np.exp([3, 6])}[rule]
    expected = alphas * factor
    np.testing.assert_allclose(weights_of(g, rule), expected / expected.max(), rtol=1e-5)  # float32 logarithms


def test_rules_follow_the_mode_unless_given():
    classic, antialiased = (MergeOptions().resolved(mode) for mode in ("classic", "antialiased"))
    assert (classic.weight, classic.opacity, classic.dilation) == ("opacity", "standard", 0.0)
    assert (antialiased.weight, antialiased.opacity, antialiased.dilation) == ("opacity-area", "optical", 0.0)
    assert MergeOptions().resolved("classic", growth=2.0).dilation == pytest.approx(0.6 / 0.7)
    assert MergeOptions().resolved("classic", growth=2.0, of_pairs=True).dilation == 0.3
    given = MergeOptions(weight="opacity-scale", opacity="mass", dilation=0.1)
    assert given.resolved("antialiased", growth=2.0) == given


def test_a_given_opacity_takes_the_place_of_the_rule():
    rng = np.random.default_rng(4)
    columns = [rng.normal(size=shape).astype(np.float32) for shape in ((6, 3), (6, 4), (6, 3), (6,), (6, 1, 3))]
    gaussians, groups = Gaussians(*columns), group(np.array([0, 0, 2, 2, 4, 5], np.int32))
    weights, opacities = np.ones(6, np.float32), np.array([0.25, 0, 0.5, 0], np.float32)
    options = MergeOptions(opacity="standard", dilation=0.0)
    ruled = fast.merge(gaussians, groups, weights, options)
    for merge_with in (fast.merge, reference.merge):
        merged = merge_with(gaussians, groups, weights, options, opacities=opacities)
        assert merged.logit_opacities[0] == np.float32(np.log(0.25 / 0.75))
        # The second is by the rule, 0 says; the others are groups of one, which nothing changes.
        np.testing.assert_allclose(merged.logit_opacities[1:], ruled.logit_opacities[1:], rtol=2e-6)


@pytest.mark.parametrize("field", ["rule", "opacity", "position"])
def test_the_compiled_merge_refuses_names_that_it_does_not_know(field):
    scene = gaussians(3, 0)
    options = MergeOptions().resolved("classic")
    object.__setattr__(options, field, "typo")  # past the check of the options
    with pytest.raises(ValueError, match=f"{field}: found 'typo', wanted one of '"):
        fast.merge(scene, group(np.zeros(3, np.int32)), np.ones(3, np.float32), options)
