import numpy as np
import pytest

import splatree as st
from splatree.metrics.gain import fitted_gain, psnr_with_gain


def pictures(seed=0):
    rng = np.random.default_rng(seed)
    image = rng.uniform(0.1, 0.5, (20, 30, 3)).astype(np.float32)
    return image, image * np.array([0.8, 1.1, 1.3], np.float32)


def test_the_gain_is_the_one_that_fits_best():
    image, photo = pictures()
    np.testing.assert_allclose(fitted_gain(image, photo), [0.8, 1.1, 1.3], rtol=1e-6)
    noisy = photo + np.random.default_rng(1).normal(0, 0.05, photo.shape).astype(np.float32)
    best = fitted_gain(image, noisy)
    error = [np.sum((gain * image - noisy) ** 2) for gain in (best, best * 1.001, best * 0.999)]
    assert error[0] < min(error[1:])
    np.testing.assert_array_equal(fitted_gain(np.zeros_like(image), photo), 1)


def test_exposure_costs_nothing_and_the_right_half_is_scored_alone():
    image, photo = pictures()
    assert psnr_with_gain(image, photo) > 120  # rounding of float32
    assert st.psnr(image, photo) < 25
    wrong = photo.copy()
    wrong[:, 15:] += 0.1
    assert psnr_with_gain(image, wrong) == pytest.approx(20, abs=1e-3)
    mask = np.ones((20, 30), bool)
    mask[:10, 20:] = False
    half = photo.copy()
    half[:10, 20:] = 0
    assert psnr_with_gain(image, half, mask) > 120


def test_a_half_without_pixels_has_no_score():
    image, photo = pictures()
    mask = np.zeros((20, 30), bool)
    mask[:, :15] = True
    assert psnr_with_gain(image, photo, mask) is None
    assert psnr_with_gain(image[:, :1], photo[:, :1]) is None
