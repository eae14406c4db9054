"""Gains of photographs, in closed form."""

import numpy as np

from splatree.kernels.reference.loss import photo_loss
from splatree.train.exposure import Gains


def loss_of(factor, seed=0):
    image = np.random.default_rng(seed).uniform(0.1, 0.4, (12, 12, 3)).astype(np.float32)
    return photo_loss(image, np.rint(255 * image * factor).astype(np.uint8), np.ones(3))


def test_the_first_visit_finds_the_factor():
    gains = Gains.ones(2)
    gains.visit(0, loss_of(1.6))
    gains.visit(1, loss_of(0.4))
    ratio = gains.of(0) / gains.of(1)
    np.testing.assert_allclose(ratio, 4, rtol=0.02)  # photographs are rounded to 8 bits
    np.testing.assert_allclose(gains.of(0) * gains.of(1), 1, rtol=1e-12)


def test_later_visits_are_mixed_in():
    gains = Gains.ones(1)
    for _ in range(20):
        gains.visit(0, loss_of(1))
    gains.visit(0, loss_of(2))
    np.testing.assert_allclose(gains.factors[0], 1.1, rtol=0.01)


def test_black_pictures_and_wild_ones_say_little():
    gains = Gains.ones(1)
    black = photo_loss(np.zeros((12, 12, 3), np.float32), np.full((12, 12, 3), 200, np.uint8), np.ones(3))
    gains.visit(0, black)
    np.testing.assert_array_equal(gains.factors[0], 1)
    faint = photo_loss(np.full((12, 12, 3), 1e-4, np.float32), np.full((12, 12, 3), 200, np.uint8), np.ones(3))
    gains.visit(0, faint)
    assert (gains.factors <= 10).all()


def test_photographs_that_were_not_visited_have_a_gain_of_one():
    gains = Gains.ones(3)
    gains.visit(1, loss_of(1.5))
    np.testing.assert_array_equal(gains.relative(), 1)  # the only one that was visited is the mean
