import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as some

from splatree.kernels import reference
from splatree.kernels.cpu.build.kmeans import assign
from splatree.maths.morton import morton_codes


def cloud(n: int, seed: int) -> np.ndarray:
    """Points whose density spans decades, in Morton order."""
    rng = np.random.default_rng(seed)
    points = (rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-2, 2, (n, 1))).astype(np.float32)
    return points[np.argsort(morton_codes(points), kind="stable")]


def squared_distances(points: np.ndarray, centers: np.ndarray) -> np.ndarray:
    return ((points[:, None].astype(np.float64) - centers[None]) ** 2).sum(axis=2)


@settings(max_examples=40)
@given(n=some.integers(1, 400), c=some.integers(1, 120), seed=some.integers(0, 99), grid=some.booleans())
def test_nearest_centres_are_those_of_the_reference(n: int, c: int, seed: int, grid: bool) -> None:
    rng = np.random.default_rng(seed)
    points, centers = cloud(n, seed), rng.normal(size=(c, 3)).astype(np.float32) * 5
    if grid:  # many ties, exact in float32
        points, centers = np.round(points), np.round(centers)
    fast, slow = assign(points, centers), reference.kmeans.assign(points, centers)
    if grid:
        np.testing.assert_array_equal(fast.labels, slow.labels)
    # Three products and two sums of float32, each within 6e-8, of differences that are rounded likewise.
    np.testing.assert_allclose(fast.squared_distances, slow.squared_distances, rtol=1e-6)
    chosen = squared_distances(points, centers)[np.arange(n), fast.labels]
    np.testing.assert_allclose(chosen, slow.squared_distances, rtol=1e-6)
    assert fast.counts.sum() == n
    np.testing.assert_array_equal(fast.counts, np.bincount(fast.labels, minlength=c))


def test_unordered_points_are_only_slower(isa: str) -> None:
    points = cloud(5000, 1)
    shuffled = np.random.default_rng(2).permutation(5000)
    centers = points[::10].copy()
    one, other = assign(points, centers), assign(points[shuffled].copy(), centers)
    assert one.labels[shuffled].tobytes() == other.labels.tobytes()


def test_thousands_of_candidates_are_compared_in_rounds() -> None:
    # All centres but one are equally far from all points: the box of the points rules out none of them by much.
    points = np.zeros((100, 3), np.float32)
    directions = np.random.default_rng(3).normal(size=(3000, 3))
    centers = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    centers[2750] *= np.float32(0.9999)
    assert set(assign(points, centers).labels) == {2750}


def test_points_that_are_spread_among_many_centres_look_for_themselves(isa: str) -> None:
    rng = np.random.default_rng(6)
    points = rng.uniform(-1, 1, (40, 3)).astype(np.float32)  # a run spans all leaves of the tree
    centers = rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)
    found = assign(points, centers)
    squared = np.sum((points[:, None].astype(np.float64) - centers) ** 2, axis=2)
    # A run searched as a whole is the slow way to the same; nearer by less than float32 rounds is as near.
    np.testing.assert_allclose(squared[np.arange(40), found.labels], squared.min(axis=1), rtol=1e-6)
