import numpy as np
import pytest

from splatree import InputError
from splatree.clusters.kmeans import _farthest, kmeans
from splatree.maths.morton import morton_codes


def cloud(n: int, seed: int) -> np.ndarray:
    """Points whose density spans decades, in Morton order."""
    rng = np.random.default_rng(seed)
    points = (rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-2, 2, (n, 1))).astype(np.float32)
    return points[np.argsort(morton_codes(points), kind="stable")]


def squared_distances(points: np.ndarray, centers: np.ndarray) -> np.ndarray:
    return ((points[:, None].astype(np.float64) - centers[None]) ** 2).sum(axis=2)


def test_same_bits_for_any_number_of_threads() -> None:
    points = cloud(20_000, 4)
    one = kmeans(points, 150, threads=1)
    for threads in (2, 3, 5):
        other = kmeans(points, 150, threads=threads)
        assert one.labels.tobytes() == other.labels.tobytes()
        assert one.centers.tobytes() == other.centers.tobytes()
        assert one.inertia == other.inertia


def test_iterations_lower_the_inertia_to_that_of_brute_force() -> None:
    points = cloud(3000, 5)
    found = kmeans(points, 40, iterations=6)
    assert list(found.inertia) == sorted(found.inertia, reverse=True)
    rng = np.random.default_rng(0)
    centers = points[np.sort(rng.choice(len(points), 40, replace=False))].astype(np.float64)
    for _ in range(len(found.inertia) - 1):
        labels = squared_distances(points, centers).argmin(axis=1)
        centers = np.stack([points[labels == j].mean(axis=0, dtype=np.float64) for j in range(40)])
    # A few points at the border of two clusters fall either way in float32.
    assert found.inertia[-1] == pytest.approx(squared_distances(points, centers).min(axis=1).sum(), rel=1e-4)


def test_empty_clusters_move_to_the_farthest_points() -> None:
    # Of 60 points 50 coincide, so most centres drawn coincide too; there is one for each of the eleven places.
    points = np.zeros((60, 3), np.float32)
    points[50:, 0] = 2.0 ** np.arange(10)
    found = kmeans(points, 11, iterations=20)
    assert found.inertia[-1] == 0
    assert len(np.unique(found.labels)) == 11


def test_the_farthest_points_are_found_in_parts(monkeypatch) -> None:
    distances = np.random.default_rng(3).integers(0, 6, 200).astype(np.float32)  # many are equal
    for count, part in ((1, 30), (7, 30), (50, 30), (200, 64), (200, 1000)):
        monkeypatch.setattr("splatree.clusters.kmeans.ROWS_AT_ONCE", part)
        wanted = np.argsort(-distances, kind="stable")[:count]
        np.testing.assert_array_equal(_farthest(distances, count), wanted)


def test_map_coordinates_keep_their_precision() -> None:
    points = np.round(cloud(2000, 6) * 4) / 4
    far = (points + np.float32(2**20)).astype(np.float32)  # quarters are exact there
    near = kmeans(points, 20)
    np.testing.assert_array_equal(near.labels, kmeans(far, 20).labels)


def test_what_cannot_be_clustered_is_refused() -> None:
    points = cloud(10, 7)
    for number in (0, 11):
        with pytest.raises(InputError, match=f"found {number} clusters for 10 points"):
            kmeans(points, number)
    points[3, 1] = np.nan
    with pytest.raises(InputError, match="at row 3, wanted finite"):
        kmeans(points, 2)
