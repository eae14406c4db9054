"""Steps of K-means on a device: the nearest centres of the definition, sums that depend on no schedule."""

import numpy as np
import pytest

from splatree.clusters.build import ClusterOptions, build_clusters
from splatree.clusters.kmeans import kmeans
from splatree.errors import InputError
from splatree.kernels import reference
from splatree.kernels.cuda import device as cuda_device
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.kmeans import DevicePoints
from splatree.scene.scene import Scene

from ..scenes import gaussians
from .simt_device import Emulator
from .test_kmeans import cloud, squared_distances

SIZES = [(1, 1), (63, 5), (64, 33), (200, 120), (700, 70)]


@pytest.mark.parametrize("grid", [True, False])
@pytest.mark.parametrize(("n", "c"), SIZES)
def test_nearest_centres_are_those_of_the_reference(n: int, c: int, grid: bool, device: Device) -> None:
    rng = np.random.default_rng(n)
    points, centers = cloud(n, n), rng.normal(size=(c, 3)).astype(np.float32) * 5
    if grid:  # many ties, exact in float32
        points, centers = np.round(points), np.round(centers)
    fast, slow = DevicePoints(device, points).assign(centers), reference.kmeans.assign(points, centers)
    if grid:
        np.testing.assert_array_equal(fast.labels, slow.labels)
        np.testing.assert_array_equal(fast.sums, slow.sums)  # whole numbers, also in float64
    # Three products and two sums of float32, each within 6e-8, of differences that are rounded likewise.
    np.testing.assert_allclose(fast.squared_distances, slow.squared_distances, rtol=1e-6)
    chosen = squared_distances(points, centers)[np.arange(n), fast.labels]
    np.testing.assert_allclose(chosen, slow.squared_distances, rtol=1e-6)
    np.testing.assert_array_equal(fast.counts, np.bincount(fast.labels, minlength=c))
    wanted = np.zeros((c, 3))
    np.add.at(wanted, fast.labels, points.astype(np.float64))
    # Each point is held to half of 2^-sum_bits, of which 2^62 / n are at least as much as its largest coordinate.
    np.testing.assert_allclose(fast.sums, wanted, atol=float(np.abs(points).max()) * n * n * 2.0**-60, rtol=1e-12)
    assert fast.inertia == pytest.approx(slow.inertia, rel=1e-6)


def test_schedule_changes_no_bit(emulator: Emulator) -> None:
    points = cloud(500, 1)
    found = []
    for seed in (1, 2, 3):
        emulator.seed(seed)
        step = DevicePoints(emulator, points).assign(points[::9].copy())
        found.append((step.sums.tobytes(), step.labels.tobytes(), step.inertia))
    assert found[0] == found[1] == found[2]


def test_unordered_points_are_only_slower(emulator: Emulator) -> None:
    points = cloud(300, 1)
    shuffled = np.random.default_rng(2).permutation(300)
    centers = np.random.default_rng(3).permutation(points)[:100].copy()
    one, other = (DevicePoints(emulator, p).assign(centers) for p in (points, points[shuffled].copy()))
    assert one.labels[shuffled].tobytes() == other.labels.tobytes()
    assert one.sums.tobytes() == other.sums.tobytes()


def test_extreme_coordinates_keep_their_sums(device: Device) -> None:
    for size in (1e-30, 1.0, 1e30):
        points = (cloud(100, 4) * np.float32(size)).astype(np.float32)
        step = DevicePoints(device, points).assign(points[:1])
        wanted = points.sum(axis=0, dtype=np.float64)
        np.testing.assert_allclose(step.sums[0], wanted, atol=float(np.abs(points).max()) * 1e-12)
    step = DevicePoints(device, np.zeros((70, 3), np.float32)).assign(np.zeros((2, 3), np.float32))
    assert step.counts.tolist() == [70, 0]
    assert step.inertia == 0


def test_clusters_are_those_of_the_processor(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_device, "open_device", lambda ordinal: device)
    points = cloud(400, 5)
    points[300:] = points[299]  # points that coincide leave centres without any, which move
    found, wanted = (kmeans(points, 40, iterations=4, device=name) for name in ("cuda", "cpu"))  # type: ignore[arg-type]
    # A point halfway between two centres may fall either way, which moves both a little.
    assert (found.labels != wanted.labels).mean() < 0.01
    np.testing.assert_allclose(found.inertia, wanted.inertia, rtol=1e-4)


def test_a_scene_is_clustered_on_the_device(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_device, "open_device", lambda ordinal: device)
    scene = Scene.flat(gaussians(300, 1))
    found, wanted = (build_clusters(scene, 12, ClusterOptions(device=name)) for name in ("cuda", "cpu"))  # type: ignore[arg-type]
    assert found.clusters is not None
    assert wanted.clusters is not None
    assert len(found.clusters) == len(wanted.clusters)
    assert found.source.metadata == wanted.source.metadata
    np.testing.assert_allclose(found.clusters.centers, wanted.clusters.centers, atol=1e-2)


def test_a_device_that_is_not_known_is_refused() -> None:
    with pytest.raises(InputError, match="device: found 'gpu', wanted one of cpu, cuda, reference"):
        kmeans(cloud(10, 1), 2, device="gpu")  # type: ignore[arg-type]
