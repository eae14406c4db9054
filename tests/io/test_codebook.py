import numpy as np
import pytest

from splatree.io.formats.sog.codebook import Codebook, sampled_rows
from splatree.io.formats.sog.codebook import find_codebook as find_codebook_of_sample


def find_codebook(x, weights=None):
    rows = sampled_rows(*x.shape)
    return find_codebook_of_sample(x[rows], lambda: x, None if weights is None else weights[rows])


def mean_error(numbers, weights, codebook):
    codes = np.searchsorted(codebook.bounds, numbers)
    return np.average((numbers - codebook.values[codes]) ** 2, weights=weights)


@pytest.mark.parametrize("kind", ["normal", "heavy tails", "two heaps"])
@pytest.mark.parametrize("is_weighted", [False, True])
def test_no_codebook_nearby_is_better(kind, is_weighted):
    rng = np.random.default_rng(0)
    x = {
        "normal": rng.normal(size=3000),
        "heavy tails": rng.standard_t(2, 3000),
        "two heaps": np.concatenate([rng.normal(-5, 0.1, 1500), rng.normal(3, 1, 1500)]),
    }[kind].astype(np.float32)
    w = rng.uniform(0.01, 1, 3000) if is_weighted else np.ones(3000)
    codebook = find_codebook(x[:, None], w if is_weighted else None)
    assert (np.diff(codebook.values) > 0).all()
    found = mean_error(x, w, codebook)
    for seed in range(3):  # from other starts Lloyd's rounds end in other local minima, none of them better
        values = np.sort(np.random.default_rng(seed).choice(x, 256, replace=False))
        for _ in range(20):
            codes = np.searchsorted((values[1:] + values[:-1]) / 2, x)
            mass = np.bincount(codes, w, 256)
            values = np.where(mass > 0, np.bincount(codes, w * x, 256) / np.where(mass > 0, mass, 1), values)
        assert found <= mean_error(x, w, Codebook(np.sort(values).astype(np.float32)))


def test_error_of_many_numbers_is_that_of_the_theory():
    """Panter & Dite 1951: for a normal density N values leave an error of √3 π / 2 · σ² / N²."""
    x = np.random.default_rng(0).normal(size=(300_000, 1)).astype(np.float32)
    wanted = np.sqrt(3) * np.pi / 2 / 256**2
    assert mean_error(x.ravel(), None, find_codebook(x)) <= 1.02 * wanted


@pytest.mark.parametrize("count", [0, 1, 2, 255, 256])
def test_few_numbers_are_kept_exactly(count):
    rng = np.random.default_rng(0)
    few = np.cumsum(np.spacing(np.ones(count, np.float32)), dtype=np.float32) + np.float32(1)  # neighbouring floats
    x = rng.permutation(np.repeat(few, 50)).reshape(-1, 1)
    codebook = find_codebook(x)
    assert np.array_equal(codebook.values[np.searchsorted(codebook.bounds, x)], x)


def test_numbers_outside_of_a_sample_count_too():
    x = np.zeros((1 << 19, 1), np.float32)
    x[1::2] = 1
    x[12345] = 2
    assert set(find_codebook(x).values) == {0.0, 1.0, 2.0}


def test_a_codebook_has_256_values():
    with pytest.raises(ValueError, match="256"):
        Codebook(np.zeros(255, np.float32))
