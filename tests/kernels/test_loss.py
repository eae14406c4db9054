"""The loss against a photograph: its slope, its kernel, its gain."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as strategy

import splatree as st
from splatree.kernels.cpu import _core
from splatree.kernels.devices import stages_of

reference, cpu = stages_of("reference"), stages_of("cpu")
GAIN = np.array([0.9, 1.1, 1.0])


def pictures(height=20, width=23, seed=0):
    rng = np.random.default_rng(seed)
    image = rng.random((height, width, 3)).astype(np.float32)
    return image, rng.integers(0, 256, (height, width, 3)).astype(np.uint8), rng.random((height, width)) > 0.2


@pytest.mark.parametrize("ssim_weight", (0.0, 0.2, 1.0))
@pytest.mark.parametrize("is_masked", (False, True))
def test_the_derivative_is_the_slope_of_the_loss(ssim_weight, is_masked):
    image, photo, mask = pictures()
    options = {"ssim_weight": ssim_weight, "mask": mask if is_masked else None}
    found = reference.photo_loss(image, photo, GAIN, **options)
    rng = np.random.default_rng(1)
    for _ in range(12):
        place = tuple(rng.integers(size) for size in image.shape)
        ends = []
        for sign in (-1, 1):
            moved = image.copy()
            moved[place] += sign * 1e-4
            ends.append((reference.photo_loss(moved, photo, GAIN, **options).value, float(moved[place])))
        slope = (ends[1][0] - ends[0][0]) / (ends[1][1] - ends[0][1])
        assert slope == pytest.approx(found.image[place], abs=float(1e-3 * np.abs(found.image).max()))


@settings(max_examples=25, deadline=None)
@given(
    size=strategy.tuples(strategy.integers(1, 150), strategy.integers(1, 420)),
    seed=strategy.integers(0, 2**31),
    isa=strategy.sampled_from(_core.isas()),
    is_masked=strategy.booleans(),
    ssim_weight=strategy.sampled_from((0.0, 0.2, 1.0)),
)
def test_the_kernel_agrees_with_the_reference(size, seed, isa, is_masked, ssim_weight):
    image, photo, mask = pictures(*size, seed)
    options = {"ssim_weight": ssim_weight, "mask": mask if is_masked else None}
    before = _core.isa()
    _core.use_isa(isa)
    try:
        found = cpu.photo_loss(image, photo, GAIN, **options)
    finally:
        _core.use_isa(before)
    expected = reference.photo_loss(image, photo, GAIN, **options)
    assert found.value == pytest.approx(expected.value, rel=1e-5, abs=1e-6)
    # The sign of a difference of 1e-7 may be either; elsewhere float32.
    assert np.abs(found.image - expected.image).max() <= 2e-4 * max(np.abs(expected.image).max(), 1e-12)
    np.testing.assert_allclose(found.errors, expected.errors, atol=1e-6)
    np.testing.assert_allclose(found.products, expected.products, rtol=1e-5)
    np.testing.assert_allclose(found.squares, expected.squares, rtol=1e-5)


def test_threads_do_not_change_a_bit():
    image, photo, mask = pictures(200, 500)
    one, three = (cpu.photo_loss(image, photo, GAIN, mask=mask, threads=threads) for threads in (1, 3))
    assert one.value == three.value
    np.testing.assert_array_equal(one.image, three.image)
    np.testing.assert_array_equal(one.squares, three.squares)


def test_the_index_is_that_of_the_metric():
    image, photo, _ = pictures(40, 50)
    found = cpu.photo_loss(image, photo, np.ones(3), ssim_weight=1.0)
    assert 1 - found.value == pytest.approx(st.ssim(image, (photo / 255).astype(np.float32), border="zero"), abs=1e-6)


def test_the_gain_in_closed_form_fits_a_darkened_picture():
    image, _, _ = pictures(40, 50)
    photo = np.rint(255 * image * [0.5, 0.7, 0.9]).astype(np.uint8)
    found = cpu.photo_loss(image, photo, np.ones(3))
    np.testing.assert_allclose(found.products / found.squares, [0.5, 0.7, 0.9], atol=1e-3)


def test_masked_pixels_do_not_matter():
    image, photo, mask = pictures(40, 50)
    other = np.where(mask[..., None], image, 7.0).astype(np.float32)
    a, b = (cpu.photo_loss(x, photo, GAIN, mask=mask) for x in (image, other))
    assert a.value == b.value
    np.testing.assert_array_equal(a.image, b.image)
    assert not a.image[~mask].any() and not a.errors[~mask].any()


def test_nothing_counts_where_all_is_masked():
    image, photo, mask = pictures()
    found = cpu.photo_loss(image, photo, GAIN, mask=np.zeros_like(mask))
    assert found.image.any() == False and np.isfinite(found.value)  # noqa: E712
