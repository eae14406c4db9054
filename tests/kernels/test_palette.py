import numpy as np
import pytest

from splatree.kernels.cpu.codec import palette as cpu
from splatree.kernels.reference import palette as reference


def scattered(n, dims, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, dims)).astype(np.float32), rng.uniform(0.1, 2, n).astype(np.float32)


def grouped(num_groups, sizes, seed=0):
    """First centres of groups, and for each of 300 points three different groups that are not empty."""
    rng = np.random.default_rng(seed)
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    used = np.flatnonzero(np.array(sizes) > 0)
    return first, np.array([rng.permutation(used)[:3] for _ in range(300)], np.int32)


def test_coordinates_along_axes_are_the_reference(isa):
    rng = np.random.default_rng(0)
    sh, origin, axes = rng.normal(size=(90, 16, 3)).astype(np.float32), rng.normal(size=45), rng.normal(size=(45, 19))
    # Sums of 45 products of order 1 in float32.
    np.testing.assert_allclose(cpu.onto_axes(sh, origin, axes), reference.onto_axes(sh, origin, axes), atol=2e-5)


@pytest.mark.parametrize("num_centres", [1, 3, 16, 17, 100])
@pytest.mark.parametrize("dims", [1, 12, 24])
def test_the_few_nearest_are_the_reference(isa, num_centres, dims):
    points, _ = scattered(203, dims)
    centres, _ = scattered(num_centres, dims, seed=1)
    found, wanted = (k.nearest_few(points, centres, 4) for k in (cpu, reference))
    assert found.shape == wanted.shape
    # Random points are never so close to a bisector that float32 would change sides.
    np.testing.assert_array_equal(found, wanted)


def test_equally_near_centres_go_by_number(isa):
    centres = np.zeros((40, 5), np.float32)
    np.testing.assert_array_equal(cpu.nearest_few(np.ones((6, 5), np.float32), centres, 3), [[0, 1, 2]] * 6)


@pytest.mark.parametrize("iterations", [0, 1, 4])
def test_centres_of_groups_are_the_reference(isa, iterations):
    points, weights = scattered(400, 6)
    group = np.random.default_rng(2).integers(0, 5, 400).astype(np.int32)
    first = np.array([0, 7, 8, 8 + 20, 28 + 3, 60], np.int64)
    found, wanted = (k.split_groups(points, weights, group, first, iterations=iterations) for k in (cpu, reference))
    # Means of float32 sums; a point on a bisector would show as a difference of 0.01 or more.
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_a_group_may_have_a_centre_for_each_point(isa):
    points, weights = scattered(9, 3)
    first = np.array([0, 9], np.int64)
    centres = cpu.split_groups(points, weights, np.zeros(9, np.int32), first, iterations=3)
    np.testing.assert_allclose(centres, points, atol=1e-6)


def test_search_in_groups_is_the_reference(isa):
    points, _ = scattered(300, 7)
    first, near = grouped(6, [4, 0, 17, 1, 33, 16])
    centres, _ = scattered(int(first[-1]), 7, seed=3)
    found, wanted = (k.nearest_in_groups(points, centres, first, near) for k in (cpu, reference))
    np.testing.assert_array_equal(found, wanted)


def test_sums_of_labels_are_the_reference():
    rng = np.random.default_rng(0)
    sh, weights = rng.normal(size=(200, 9, 3)).astype(np.float32), rng.uniform(0.1, 2, 200).astype(np.float32)
    labels = rng.integers(0, 30, 200).astype(np.int32)
    found, wanted = np.ones((32, 25)), np.ones((32, 25))
    for kernel, sums in ((cpu, found), (reference, wanted)):
        kernel.add_to_sums(sh, weights, labels, sums)
    np.testing.assert_allclose(found, wanted, rtol=1e-14)  # sums of float64, in the same order
    assert (found[30:] == 1).all()


@pytest.mark.parametrize("limit", [9, 10, 300])
def test_equal_rows_are_numbered_as_by_the_reference(limit):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(10, 16, 3)).astype(np.float32)
    sh = rows[rng.integers(0, 10, 200)]
    sh[:, 0] = rng.normal(size=(200, 3))  # the DC plays no part
    found, wanted = (k.DistinctRows(45, limit) for k in (cpu, reference))
    for part in (sh[:150], sh[150:]):
        a, b = found.number(part), wanted.number(part)
        assert (a is None) == (b is None) == (limit < 10)
        np.testing.assert_array_equal([] if a is None else a, [] if b is None else b)
    if limit >= 10:
        np.testing.assert_array_equal(found.entries, wanted.entries)


def test_any_number_of_threads_gives_the_same_bits(isa):
    points, weights = scattered(9000, 5)
    coarse, _ = scattered(12, 5, seed=1)
    first = np.arange(0, 13 * 40, 40, dtype=np.int64)
    results = []
    for threads in (1, 2, 5):
        near = cpu.nearest_few(points, coarse, 3, threads=threads)
        group = np.ascontiguousarray(near[:, 0])
        centres = cpu.split_groups(points, weights, group, first, iterations=2, threads=threads)
        labels = cpu.nearest_in_groups(points, centres, first, near, threads=threads)
        means = cpu.point_means(points, weights, labels, len(centres), threads=threads)
        results.append([a.tobytes() for a in (near, centres, labels, means)])
    assert results[0] == results[1] == results[2]
