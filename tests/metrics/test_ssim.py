import numpy as np
import pytest

from splatree.constants import SSIM_SIGMA_PX, SSIM_WINDOW_PX
from splatree.errors import InputError
from splatree.metrics.ssim import ssim


def pictures():
    """Two smooth pictures with edges, from formulas."""
    y, x = np.mgrid[0:40, 0:52]
    a = np.stack(
        [0.5 + 0.5 * np.sin(x / 5 + y / 9), (x * y) % 17 / 16, np.exp(-((x - 20) ** 2 + (y - 18) ** 2) / 150)], -1
    )
    return a, np.clip(a * 0.9 + 0.04 * np.cos(x / 3)[..., None] + 0.02, 0, 1)


def test_ssim_equals_scikit_image():
    # structural_similarity(a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=-1)
    # of scikit-image 0.26.0; both compute in float64, in another order of sums.
    assert ssim(*pictures()) == pytest.approx(0.9561919563664203, abs=1e-12)


def test_ssim_equals_its_definition_at_one_window():
    rng = np.random.default_rng(3)
    a, b = rng.random((2, SSIM_WINDOW_PX, SSIM_WINDOW_PX, 1))
    offset = np.arange(SSIM_WINDOW_PX) - SSIM_WINDOW_PX // 2
    window = np.exp(-(offset[:, None] ** 2 + offset**2) / (2 * SSIM_SIGMA_PX**2))[..., None]
    window /= window.sum()
    mean_a, mean_b = (window * a).sum(), (window * b).sum()
    variance_a, variance_b = (window * (a - mean_a) ** 2).sum(), (window * (b - mean_b) ** 2).sum()
    covariance = (window * (a - mean_a) * (b - mean_b)).sum()
    expected = (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4)
    expected /= (mean_a**2 + mean_b**2 + 1e-4) * (variance_a + variance_b + 9e-4)
    assert ssim(a, b) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("border", ["valid", "zero"])
def test_ssim_is_one_for_equal_pictures_and_symmetric(border):
    a, b = pictures()
    assert ssim(a, a, border=border) == pytest.approx(1.0, abs=1e-12)
    assert ssim(a, b, border=border) == ssim(b, a, border=border)


def test_zero_border_is_the_valid_region_of_the_framed_pictures():
    a, b = pictures()
    frame = ((5, 5), (5, 5), (0, 0))
    assert ssim(a, b, border="zero") == pytest.approx(ssim(np.pad(a, frame), np.pad(b, frame)), abs=1e-12)
    assert abs(ssim(a, b, border="zero") - ssim(a, b)) > 1e-4  # the two conventions are not the same number


def test_picture_smaller_than_the_window_is_refused():
    with pytest.raises(InputError, match="at least 11 × 11"):
        ssim(np.zeros((10, 20, 3)), np.zeros((10, 20, 3)))


def test_unknown_border_is_refused():
    with pytest.raises(InputError, match="border"):
        ssim(*pictures(), border="reflect")
