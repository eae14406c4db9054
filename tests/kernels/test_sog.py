import numpy as np
import pytest

from splatree.kernels.cpu.codec import sog as cpu
from splatree.kernels.reference import sog as reference

from ..scenes import gaussians


def bounds(low, high):
    return np.sort(np.random.default_rng(5).uniform(low, high, 255)).astype(np.float32)


def encoded(kernel, g, places, ranges, num_pixels, labels=None, **options):
    channels = {"means_l": 3, "means_u": 3, "quats": 4, "scales": 3, "sh0": 4, "labels": 3}
    pixels = {name: np.zeros((num_pixels, c), np.uint8) for name, c in channels.items()}
    kernel.encode(g, places, ranges, (bounds(-5, -1.5), bounds(-1, 1)), pixels, labels=labels, **options)
    return pixels


def ranges_of(g):
    m = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    return np.array([m.min(axis=0), m.max(axis=0)]) if len(g) else np.zeros((2, 3))


@pytest.mark.parametrize("n", [0, 1, 3000])
def test_codes_are_those_of_the_reference_up_to_values_between_two(n):
    g = gaussians(n, 0, spread=40.0)
    rng = np.random.default_rng(1)
    places, labels = rng.permutation(n + 5)[:n].astype(np.int32), rng.integers(0, 1 << 16, n).astype(np.int32)
    found, wanted = (encoded(k, g, places, ranges_of(g), n + 5, labels) for k in (cpu, reference))
    for name in ("scales", "sh0", "labels"):
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
    codes = encoded(cpu, g, np.arange(5, dtype=np.int32), ranges_of(g), 5)
    assert not codes["means_l"][:, 1].any() and not codes["means_u"][:, 1].any()


@pytest.mark.parametrize("kind", ["normal", "far outliers", "few different", "all equal"])
def test_codes_count_the_bounds_below(kind):
    rng = np.random.default_rng(0)
    edges = rng.normal(size=255)
    if kind == "far outliers":
        edges[:3] = (-1e38, 1e6, 3e38)
    edges = np.sort(np.round(edges) if kind == "few different" else 0 * edges if kind == "all equal" else edges)
    edges = edges.astype(np.float32)
    around = [edges, np.nextafter(edges, np.float32(-np.inf)), np.nextafter(edges, np.float32(np.inf))]
    values = np.concatenate([*around, rng.normal(size=500), [-3e38, 3e38]]).astype(np.float32).reshape(-1, 1)
    np.testing.assert_array_equal(cpu.find_codes(values, edges), np.searchsorted(edges, values))


def test_any_number_of_threads_gives_the_same_codes():
    g = gaussians(20_000, 3)
    places = np.arange(len(g), dtype=np.int32)[::-1].copy()
    ranges = np.array([[-3.0, -3, -3], [3, 3, 3]])
    one, many = (encoded(cpu, g, places, ranges, len(g), threads=t) for t in (1, 4))
    assert all(one[name].tobytes() == many[name].tobytes() for name in one)


def coded(n, degree, palette=300):
    """Random pixels of every picture, and random tables."""
    rng = np.random.default_rng(3)
    pixels = {
        name: rng.integers(0, 256, (n, c), np.uint8)
        for name, c in {"means_l": 3, "means_u": 3, "quats": 4, "scales": 3, "sh0": 4, "labels": 3}.items()
    }
    pixels["quats"][:, 3] = rng.integers(252, 256, n)
    pixels["labels"][:, 1] = 0  # labels below 256
    num_rest = 3 * ((degree + 1) ** 2 - 1)
    tables = reference.SogTables(
        *(rng.normal(size=shape).astype(np.float32) for shape in ((3, 1 << 16), (3, 256), (3, 256), 256)),
        rng.normal(size=256).astype(np.float32) if degree else None,
        rng.integers(0, 256, (palette, num_rest), np.uint8) if degree else None,
    )
    return pixels, tables


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("n", [0, 1, 3000])
def test_decoded_values_are_those_of_the_reference(n, degree):
    pixels, tables = coded(n, degree)
    found, wanted = gaussians(n, 0, degree=degree), gaussians(n, 1, degree=degree)
    assert cpu.decode(pixels, tables, found) == reference.decode(pixels, tables, wanted) == (-1, -1)
    for column in ("means", "log_scales", "logit_opacities", "sh"):  # looked up
        np.testing.assert_array_equal(getattr(found, column), getattr(wanted, column))
    np.testing.assert_allclose(found.quats, wanted.quats, atol=1e-7)  # one rounding to float32 of numbers up to 1


def test_codes_that_stand_for_nothing_give_zeros_and_the_first_such_row():
    pixels, tables = coded(20_000, 1, palette=256)
    pixels["quats"][[11_000, 19_000], 3] = 7
    pixels["labels"][[9_001, 12_345], 1] = 1
    found, wanted = gaussians(20_000, 0), gaussians(20_000, 1)
    assert cpu.decode(pixels, tables, found) == reference.decode(pixels, tables, wanted) == (11_000, 9_001)
    assert not found.quats[19_000].any() and not found.sh[12_345, 1:].any()
    np.testing.assert_array_equal(found.sh, wanted.sh)
