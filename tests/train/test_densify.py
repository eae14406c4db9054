"""Births and removal: exact numbers, moments that are kept, nothing removed for being unseen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from splatree.maths.covariance import covariances_from_gaussians
from splatree.scene.gradients import Moments
from splatree.train.densify import CENTRE, Rows, Sightings, densified, split

from ..scenes import cloud

EXTENT = 100.0


def rows_of(n, seed=0, **kinds):
    gaussians = cloud(n, seed, degree=1, **kinds)
    moments = Moments.zeros(n, 4)
    moments.values[:] = np.random.default_rng(seed).random(moments.values.shape)
    moments.steps[:] = np.arange(n) % 60000 + 1
    return Rows(gaussians, moments)


def seen_by_all(n, weight=10.0):
    return Sightings(np.linspace(1, 2, n), np.full(n, weight, np.float32))


@given(seed=some.integers(0, 99))
def test_split_keeps_the_second_moment_and_the_opacity_at_the_centre(seed):
    gaussians = cloud(20, seed, logits=("uniform", -4, 1.5))
    first, second = split(gaussians)
    middle = (first.means.astype(float) + second.means) / 2
    np.testing.assert_allclose(middle, gaussians.means, atol=1e-6)  # one rounding of float32 in means of order 1
    shift = (first.means.astype(float) - second.means) / 2
    after = covariances_from_gaussians(first.quats, first.log_scales) + shift[:, :, None] * shift[:, None]
    before = covariances_from_gaussians(gaussians.quats, gaussians.log_scales)
    # 0.7² + 0.714² = 0.9998
    assert np.abs(after - before).max(axis=(1, 2)) == pytest.approx(0, abs=1e-3 * before.max())
    at_centre = 1 - (1 - CENTRE * first.opacities()) ** 2
    np.testing.assert_allclose(at_centre, gaussians.opacities(), rtol=1e-3)
    longest = np.argmax(gaussians.log_scales, axis=1)
    distance = np.linalg.norm(shift, axis=1) / gaussians.scales()[np.arange(20), longest]
    np.testing.assert_allclose(distance, 0.7, rtol=1e-4)
    np.testing.assert_allclose(np.exp(-0.5 * (0.7 / 0.714) ** 2), CENTRE, rtol=1e-3)


@pytest.mark.parametrize(("target", "count"), [(100, 100), (130, 130), (150, 150), (400, 150), (50, 100)])
def test_the_number_of_gaussians_is_exact(target, count):
    """At most half as many births as rows; a target below what there is removes nothing."""
    rows = rows_of(100)
    assert len(densified(rows, seen_by_all(100), target, EXTENT, np.random.default_rng(0)).gaussians) == count


def test_unseen_rows_are_never_removed_and_hidden_ones_are():
    rows = rows_of(100, logits=("uniform", 0, 3))
    weights = np.full(100, -1, np.float32)
    weights[:10] = 0.01
    left = densified(rows, Sightings(np.zeros(100), weights), 100, EXTENT, np.random.default_rng(0)).gaussians
    assert {tuple(mean) for mean in left.means} == {tuple(mean) for mean in rows.gaussians.means[10:]}


def test_faint_and_huge_rows_and_what_is_no_number_are_removed():
    rows = rows_of(10)
    rows.gaussians.logit_opacities[0] = -6  # 0.0025
    rows.gaussians.log_scales[1] = np.log(60)
    rows.gaussians.means[2] = np.nan
    rows.gaussians.sh[3, 1] = np.inf
    left = densified(rows, seen_by_all(10), 6, EXTENT, np.random.default_rng(0)).gaussians
    assert {tuple(mean) for mean in left.means} == {tuple(mean) for mean in rows.gaussians.means[4:]}


def test_births_are_where_the_error_is():
    rows = rows_of(1000)
    errors = np.ones(1000)
    errors[:500] = 9
    seen = Sightings(errors, np.full(1000, 10, np.float32))
    seen.weights[900:] = 1.5  # too few pixels to be divided
    born = densified(rows, seen, 1200, EXTENT, np.random.default_rng(0))
    kept = {tuple(mean) for mean in born.gaussians.means}
    divided = np.array([tuple(mean) not in kept for mean in rows.gaussians.means])
    assert divided.sum() == 200 and not divided[900:].any()
    # 9 of 10 births would fall among the first half, were rows put back; without it a few less.
    assert 160 <= divided[:500].sum() <= 195


def test_halves_begin_anew_and_others_keep_their_moments():
    rows = rows_of(50)
    after = densified(rows, seen_by_all(50), 60, EXTENT, np.random.default_rng(0))
    fresh = after.moments.steps == 0
    assert fresh.sum() == 20 and not after.moments.values[fresh].any()
    place = {tuple(mean): i for i, mean in enumerate(rows.gaussians.means)}
    for i in np.flatnonzero(~fresh):
        before = place[tuple(after.gaussians.means[i])]
        assert after.moments.steps[i] == rows.moments.steps[before]
        np.testing.assert_array_equal(after.moments.values[i], rows.moments.values[before])
