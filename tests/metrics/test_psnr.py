import numpy as np
import pytest

from splatree.errors import InputError
from splatree.metrics.flip import flip
from splatree.metrics.psnr import psnr
from splatree.metrics.ssim import ssim


def test_psnr_of_a_constant_difference_is_its_decibels():
    image = np.full((4, 5, 3), 0.5, np.float32)
    assert psnr(image, image + np.float32(0.125)) == pytest.approx(
        20 * np.log10(8), abs=1e-9
    )  # 0.125 is exact in binary


def test_psnr_of_equal_pictures_is_infinite():
    image = np.random.default_rng(0).random((3, 3, 3)).astype(np.float32)
    assert psnr(image, image) == float("inf")


def test_psnr_scales_with_the_peak():
    rng = np.random.default_rng(1)
    a, b = rng.random((6, 7, 3)), rng.random((6, 7, 3))
    assert psnr(255 * a, 255 * b, peak=255.0) == pytest.approx(psnr(a, b), abs=1e-9)


@pytest.mark.parametrize(
    ("image", "reference", "message"),
    [
        (np.zeros((2, 3, 3)), np.zeros((3, 2, 3)), "shapes"),
        (np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), "at least one pixel"),
        (np.full((2, 2, 3), np.nan), np.zeros((2, 2, 3)), "NaN"),
    ],
)
def test_pictures_that_cannot_be_compared_are_refused(image, reference, message):
    with pytest.raises(InputError, match=message):
        psnr(image, reference)


@pytest.mark.parametrize("measure", [psnr, ssim, flip])
def test_bytes_are_no_colours_of_0_to_1(measure):
    a, b = (np.full((16, 16, 3), value, np.uint8) for value in (200, 100))
    with pytest.raises(InputError, match="found uint8, wanted floats from 0 to 1; divide bytes by 255"):
        measure(a, b)


def test_bytes_may_be_compared_by_their_own_peak():
    a, b = (np.full((16, 16, 3), value, np.uint8) for value in (200, 100))
    assert psnr(a, b, peak=255) == pytest.approx(20 * np.log10(255 / 100), abs=1e-9)
    assert ssim(a, b, peak=255) == pytest.approx(ssim(a / 255, b / 255), abs=1e-9)
