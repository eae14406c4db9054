import numpy as np
import pytest

from splatree.kernels.cpu import sog as cpu
from splatree.kernels.reference import sog as reference

from .conftest import gaussians


def bounds(low, high):
    return np.sort(np.random.default_rng(5).uniform(low, high, 255)).astype(np.float32)


@pytest.mark.parametrize("n", [0, 1, 3000])
def test_codes_are_those_of_the_reference_up_to_values_between_two(n):
    g = gaussians(n, 0, spread=40.0)
    order = np.random.default_rng(1).permutation(n).astype(np.int32)
    m = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    ranges = np.array([m.min(axis=0), m.max(axis=0)]) if n else np.zeros((2, 3))
    found, wanted = (k.encode(g, order, ranges, bounds(-5, -1.5), bounds(-1, 1)) for k in (cpu, reference))
    assert found.keys() == wanted.keys()
    for name in ("scales", "sh0"):
        np.testing.assert_array_equal(found[name][:, :3], wanted[name][:, :3])  # only comparisons of float32
    # The last bit of a float64 may fall to the other side of a half: at most one code, hardly ever.
    u, v = (
        np.concatenate([k["means_l"] + 256 * k["means_u"].astype(int), k["quats"], k["sh0"]], 1)
        for k in (found, wanted)
    )
    assert np.abs(u - v).max(initial=0) <= 1
    assert (u != v).sum() <= 2


def test_a_range_without_length_gives_code_0():
    g = gaussians(5, 0)
    g.means[:, 1] = 7.0
    m = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    ranges = np.array([m.min(axis=0), m.max(axis=0)])
    codes = cpu.encode(g, np.arange(5, dtype=np.int32), ranges, bounds(-5, -1), bounds(-1, 1))
    assert not codes["means_l"][:, 1].any() and not codes["means_u"][:, 1].any()


def test_codes_count_the_bounds_below():
    edges = np.sort(np.random.default_rng(0).normal(size=255)).astype(np.float32)
    values = np.concatenate([edges, np.random.default_rng(1).normal(size=500).astype(np.float32), [-1e9, 1e9]])
    values = values.astype(np.float32).reshape(-1, 1)
    np.testing.assert_array_equal(cpu.find_codes(values, edges), np.searchsorted(edges, values))


def test_any_number_of_threads_gives_the_same_codes():
    g = gaussians(20_000, 3)
    order = np.arange(len(g), dtype=np.int32)[::-1].copy()
    ranges = np.array([[-3.0, -3, -3], [3, 3, 3]])
    one, many = (cpu.encode(g, order, ranges, bounds(-5, -1), bounds(-1, 1), threads=t) for t in (1, 4))
    assert all(one[name].tobytes() == many[name].tobytes() for name in one)
