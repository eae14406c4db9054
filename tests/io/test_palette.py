import numpy as np
import pytest

from splatree.io.formats.sog.palette import find_palette as find_palette_of_parts


def find_palette(sh, weights, count, **options):
    """Of rows in parts of 700."""
    return find_palette_of_parts(
        lambda: (sh[begin : begin + 700] for begin in range(0, len(sh), 700)), weights, count, **options
    )


def harmonics(n, degree=3, seed=0):
    """Mixtures in a few directions, as trained scenes have them, and noise in all."""
    rng = np.random.default_rng(seed)
    width = 3 * ((degree + 1) ** 2 - 1)
    heaps = rng.normal(size=(40, 8))
    mixed = heaps[rng.integers(0, 40, n)] + 0.5 * rng.normal(size=(n, 8))
    rest = mixed @ rng.normal(size=(8, width)) + 0.1 * rng.normal(size=(n, width))
    sh = np.zeros((n, (degree + 1) ** 2, 3), np.float32)
    sh[:, 1:] = rest.reshape(n, -1, 3)
    return sh, rng.uniform(0.01, 1, n).astype(np.float32)


def error(sh, weights, entries, labels):
    return np.average(((sh[:, 1:] - entries[labels]) ** 2).sum(axis=(1, 2)), weights=weights)


def exact_kmeans(x, weights, count, rounds):
    """Lloyd's rounds with a full search, from rows drawn by their weight."""
    start = np.random.default_rng(0).choice(len(x), count, replace=False, p=weights / weights.sum())
    centres = x[start]
    for _ in range(rounds + 1):
        labels = ((x**2).sum(1)[:, None] - 2 * x @ centres.T + (centres**2).sum(1)).argmin(axis=1)
        for c in np.unique(labels):
            centres[c] = np.average(x[labels == c], axis=0, weights=weights[labels == c])
    return centres, labels


def test_error_is_that_of_exact_kmeans():
    sh, weights = harmonics(1500)
    palette = find_palette(sh, weights, 128)
    centres, labels = exact_kmeans(sh[:, 1:].reshape(1500, -1).astype(np.float64), weights.astype(np.float64), 128, 6)
    wanted = error(sh, weights, centres.reshape(128, 15, 3), labels)
    # K-means ends in one of many local minima, which differ by a few percent.
    assert error(sh, weights, palette.entries, palette.labels) <= 1.05 * wanted


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("n, count", [(1, 1), (5, 5), (300, 20), (300, 299), (2000, 1)])
def test_sizes(degree, n, count):
    sh, weights = harmonics(n, degree)
    palette = find_palette(sh, weights, count)
    assert palette.entries.shape == (min(n, count), (degree + 1) ** 2 - 1, 3)
    assert palette.labels.min() >= 0 and palette.labels.max() < len(palette.entries)
    if count == n:
        assert np.array_equal(palette.entries[palette.labels], sh[:, 1:])


def test_few_vectors_are_kept_exactly():
    sh, _ = harmonics(50)
    sh = sh[np.random.default_rng(1).integers(0, 50, 4000)]
    palette = find_palette(sh, np.ones(4000, np.float32), 50)
    assert np.array_equal(palette.entries[palette.labels], sh[:, 1:])


def test_rows_that_weigh_more_are_kept_better():
    sh, _ = harmonics(4000)
    weights = np.where(np.arange(4000) % 2, 1.0, 0.001).astype(np.float32)
    palette = find_palette(sh, weights, 200)
    errors = ((sh[:, 1:] - palette.entries[palette.labels]) ** 2).sum(axis=(1, 2))
    assert 1.2 * errors[1::2].mean() < errors[::2].mean()


def test_vectors_without_any_spread_in_most_axes():
    sh = np.zeros((500, 16, 3), np.float32)
    sh[:, 4, 1] = np.linspace(-1, 1, 500)
    palette = find_palette(sh, np.ones(500, np.float32), 50)
    assert np.abs(palette.entries[palette.labels] - sh[:, 1:]).max() < 0.05  # 50 values for a length of 2


def test_any_number_of_threads_gives_the_same_palette():
    sh, weights = harmonics(3000)
    one, many = (find_palette(sh, weights, 300, threads=t) for t in (1, 3))
    assert one.entries.tobytes() == many.entries.tobytes() and one.labels.tobytes() == many.labels.tobytes()


@pytest.mark.parametrize("num_different", [50, 3000])
def test_any_parts_give_the_same_palette(num_different):
    sh, weights = harmonics(3000)
    sh = sh[np.arange(3000) % num_different]
    one = find_palette_of_parts(lambda: [sh], weights, 60)
    many = find_palette(sh, weights, 60)
    assert one.entries.tobytes() == many.entries.tobytes() and one.labels.tobytes() == many.labels.tobytes()
