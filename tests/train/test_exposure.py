"""Exposures of photographs, in closed form."""

import numpy as np
import pytest

from splatree.kernels.reference.loss import photo_loss
from splatree.train.exposure import Exposures, exposed, is_gain

TINT = np.array([[1.2, 0.1, 0, 0.02], [0, 0.9, 0.1, 0], [-0.1, 0, 1.1, 0.05]])


def visited(exposures, i, change, seed=0):
    """After a visit of a photograph that shows a picture changed by a factor or a matrix."""
    image = np.random.default_rng(seed).uniform(0.1, 0.4, (12, 12, 3)).astype(np.float32)
    photo = image * np.float32(change) if np.isscalar(change) else exposed(image, change)
    photo = np.rint(255 * photo).astype(np.uint8)
    exposures.visit(i, photo_loss(image, photo, np.ones(3)), image, photo)
    return image, photo


def test_the_first_visit_finds_the_factor():
    exposures = Exposures.none(2)
    visited(exposures, 0, 1.6)
    visited(exposures, 1, 0.4)
    one, other = (np.diag(exposures.of(i)[:, :3]) for i in (0, 1))
    np.testing.assert_allclose(one / other, 4, rtol=0.02)  # photographs are rounded to 8 bits
    np.testing.assert_allclose(one * other, 1, rtol=1e-12)
    assert is_gain(exposures.of(0)) and not is_gain(TINT)


def test_later_visits_are_mixed_in():
    exposures = Exposures.none(1)
    for _ in range(20):
        visited(exposures, 0, 1.0)
    visited(exposures, 0, 2.0)
    np.testing.assert_allclose(np.diag(exposures.matrices[0]), 1.1, rtol=0.01)


@pytest.mark.parametrize("is_affine", [False, True])
def test_black_pictures_and_wild_ones_say_little(is_affine):
    exposures = Exposures.none(1, is_affine=is_affine)
    photo = np.full((12, 12, 3), 200, np.uint8)
    for value in (0, 1e-4):
        image = np.full((12, 12, 3), value, np.float32)
        exposures.visit(0, photo_loss(image, photo, np.ones(3)), image, photo)
        if value == 0 and not is_affine:
            np.testing.assert_array_equal(np.diag(exposures.matrices[0]), 1)
        assert np.isfinite(exposures.matrices).all() and np.abs(exposures.matrices).max() <= 10


@pytest.mark.parametrize("is_affine", [False, True])
def test_photographs_that_were_not_visited_are_as_the_scene(is_affine):
    exposures = Exposures.none(3, is_affine=is_affine)
    visited(exposures, 1, 1.5)
    # the only one that was visited is the mean
    np.testing.assert_allclose(exposures.relative(), np.tile(np.eye(3, 4), (3, 1, 1)), atol=1e-12)


def test_an_affine_exposure_explains_what_a_gain_cannot():
    errors = {}
    for is_affine in (False, True):
        exposures = Exposures.none(1, is_affine=is_affine)
        image, photo = visited(exposures, 0, TINT)
        errors[is_affine] = np.abs(exposed(image, exposures.matrices[0]) - photo / 255).mean()
    assert errors[True] < 0.5 * errors[False]  # the prior keeps it from being exact


def test_affine_exposures_have_the_identity_as_their_mean():
    exposures = Exposures.none(3, is_affine=True)
    for i, change in enumerate((TINT, 1.3, 0.8)):
        visited(exposures, i, change, seed=i)
    np.testing.assert_allclose(exposures.relative().mean(axis=0), np.eye(3, 4), atol=1e-12)


def test_an_affine_exposure_without_colours_is_a_gain():
    """A grey picture does not tell channels apart, nor a brightness from a factor: the prior chooses the gain."""
    exposures = Exposures.none(1, is_affine=True)
    image = np.full((12, 12, 3), 0.4, np.float32)
    photo = np.full((12, 12, 3), 153, np.uint8)  # 1.5 times as bright
    exposures.visit(0, photo_loss(image, photo, np.ones(3)), image, photo)
    # float32 sums, over a prior of 0.002 of them: a thousandth
    np.testing.assert_allclose(exposures.matrices[0], 1.5 * np.eye(3, 4), atol=1e-3)
