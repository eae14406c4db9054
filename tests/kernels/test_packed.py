import numpy as np
import pytest

from splatree import Gaussians
from splatree.kernels.cpu.codec import packed as cpu
from splatree.kernels.reference import packed as reference

LOGITS = np.linspace(-9, 9, 256, dtype=np.float32)


def gaussians(n, degree, seed=0):
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.standard_normal(shape).astype(np.float32)

    return Gaussians(
        10 * normal(n, 3), normal(n, 4), 6 * normal(n, 3) - 4, 3 * normal(n), normal(n, (degree + 1) ** 2, 3)
    )


def parts(vertices):
    """Each number of the four words, and the steps that its range has."""
    position, rotation, scale, color = vertices.T.astype(np.int64)
    fields = [
        (word >> shift & most, most)
        for word in (position, scale)
        for shift, most in ((21, 2047), (11, 1023), (0, 2047))
    ]
    fields += [(rotation >> shift & 1023, 1023) for shift in (20, 10, 0)] + [(rotation >> 30, 3)]
    return fields + [(color >> shift & 255, 255) for shift in (24, 16, 8, 0)]


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [1, 255, 257, 1500])
def test_packed_chunks_are_the_reference(isa, n, degree):
    g = gaussians(n, degree)
    order = np.random.default_rng(1).permutation(n)
    found, wanted = (kernel.pack(g, order) for kernel in (cpu, reference))
    # A colour of a bound is one product and sum, which one rounding or two may end.
    np.testing.assert_allclose(found[0], wanted[0], rtol=2e-7, atol=1e-7)
    different = 0
    for (a, _), (b, _) in zip(parts(found[1]), parts(wanted[1]), strict=True):
        assert np.abs(a - b).max() <= 1  # a value on a rounding step may fall either way
        different += int((a != b).sum())
    assert different <= 0.001 * 14 * n + 1
    np.testing.assert_array_equal(found[2], wanted[2])


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [1, 256, 700])
def test_unpacked_chunks_are_the_reference(isa, n, degree):
    rng = np.random.default_rng(n)
    bounds = np.sort(rng.standard_normal((-(-n // 256), 3, 2, 3)), axis=2).reshape(-1, 18).astype(np.float32)
    vertices = rng.integers(0, 2**32, (n, 4), dtype=np.uint32)
    rest = rng.integers(0, 256, (n, 3 * ((degree + 1) ** 2 - 1)), dtype=np.uint8)
    results = []
    for kernel in (cpu, reference):
        columns = tuple(
            np.full(shape, 9, np.float32) for shape in ((n, 3), (n, 4), (n, 3), (n,), (n, (degree + 1) ** 2, 3))
        )
        kernel.unpack(bounds, vertices, rest, LOGITS, columns)
        results.append(columns)
    for name, a, b in zip(("means", "quats", "log_scales", "logits", "sh"), *results, strict=True):
        # The largest component of a rotation is the root of a difference, which codes of no rotation bring near 0.
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-3 if name == "quats" else 1e-6, err_msg=name)


def test_a_range_of_one_value_gives_it_back(isa):
    g = gaussians(300, 0)
    g = Gaussians(
        *(np.repeat(column[:1], 300, 0) for column in (g.means, g.quats, g.log_scales, g.logit_opacities, g.sh))
    )
    packed = cpu.pack(g, np.arange(300))
    columns = tuple(np.empty_like(column) for column in (g.means, g.quats, g.log_scales, g.logit_opacities, g.sh))
    cpu.unpack(*packed, LOGITS, columns)
    np.testing.assert_array_equal(columns[0], g.means)
    np.testing.assert_array_equal(columns[2], g.log_scales)
    np.testing.assert_allclose(columns[4], g.sh, atol=1e-6)


def test_threads_change_nothing(isa):
    g = gaussians(3000, 3)
    one, many = (cpu.pack(g, np.arange(3000), threads=threads) for threads in (1, 3))
    for a, b in zip(one, many, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_row_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="no such row"):
        cpu.pack(gaussians(3, 0), np.array([0, 3]))
