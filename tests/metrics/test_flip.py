"""FLIP: laws that follow from its definition, stored values of its authors' program, and that program itself where it is."""

import numpy as np
import pytest

from splatree.errors import InputError
from splatree.metrics.flip import flip, flip_map


def pictures(seed, height=40, width=50):
    rng = np.random.default_rng(seed)
    smooth = np.kron(rng.random((height // 10, width // 10, 3)), np.ones((10, 10, 1)))
    reference = smooth.astype(np.float32)
    return reference, np.clip(reference + rng.normal(scale=0.1, size=reference.shape), 0, 1).astype(np.float32)


def test_equal_pictures_do_not_differ():
    reference, _ = pictures(0)
    assert flip(reference, reference) == 0


def test_it_is_the_same_both_ways():
    reference, noisy = pictures(1)
    assert np.array_equal(flip_map(reference, noisy), flip_map(noisy, reference))


def test_opposite_colors_are_as_different_as_can_be():
    """Green against blue is the pair that maps to 1; black against white comes near it."""
    green, blue = np.zeros((2, 30, 30, 3), np.float32)
    green[..., 1], blue[..., 2] = 1, 1
    assert flip(green, blue) == pytest.approx(1, abs=1e-6)
    assert flip(np.zeros_like(green), np.ones_like(green)) > 0.9


def test_more_noise_is_more_visible():
    reference, _ = pictures(2)
    noise = np.random.default_rng(3).normal(size=reference.shape)
    values = [flip(np.clip(reference + s * noise, 0, 1).astype(np.float32), reference) for s in (0.01, 0.03, 0.1, 0.3)]
    assert values == sorted(values) and values[0] > 0


def test_line_that_is_missing_is_seen_where_it_was():
    flat = np.full((60, 60, 3), 0.5, np.float32)
    line = flat.copy()
    line[:, 30] = 0.4
    errors = flip_map(flat, line)
    assert errors[:, 29:32].min() > 0.1
    assert errors[:, :5].max() < 1e-3  # farther away than the filters reach


@pytest.mark.parametrize(("seed", "mean"), [(0, 0.198313), (1, 0.183442), (2, 0.202342)])
def test_values_of_the_authors_program(seed, mean):
    """Stored from flip-evaluator 1.7; it computes in float32."""
    reference, noisy = pictures(seed)
    assert flip(noisy, reference) == pytest.approx(mean, abs=2e-5)


def test_the_authors_program_says_the_same():
    peer = pytest.importorskip("flip_evaluator", reason="needs flip-evaluator, which has no wheel for this machine")
    for seed in range(3):
        reference, noisy = pictures(seed, 60, 80)
        errors, _, _ = peer.evaluate(reference, noisy, "LDR", applyMagma=False)
        # Its filters are cut and summed in float32.
        assert np.abs(flip_map(noisy, reference) - errors[..., 0]).max() < 2e-4


def test_what_cannot_be_compared_is_refused():
    reference, noisy = pictures(0)
    with pytest.raises(InputError, match="shapes"):
        flip(noisy[:-1], reference)
    with pytest.raises(InputError, match="RGB"):
        flip(noisy[..., 0], reference[..., 0])
