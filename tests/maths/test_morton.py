import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from splatree.maths.morton import morton_codes


def interleave(x: int, y: int, z: int) -> int:
    return sum(((x >> b & 1) << 2 | (y >> b & 1) << 1 | (z >> b & 1)) << 3 * b for b in range(21))


def test_codes_interleave_the_bits_of_the_cells():
    rng = np.random.default_rng(0)
    cells = rng.integers(0, 2**21, size=(100, 3))
    cells[:2] = [[0, 0, 0], [2**21 - 1] * 3]
    cells = np.repeat(
        cells, [50, 50] + [1] * 98, axis=0
    )  # the ends carry the quantiles, so that the grid is the integers
    codes = morton_codes(cells.astype(np.float64))
    assert codes.tolist() == [interleave(*(int(v) for v in cell)) for cell in cells]


@given(st.integers(0, 100))
def test_codes_ignore_offset_and_scale(seed):
    points = np.random.default_rng(seed).integers(0, 1000, size=(200, 3)).astype(np.float64)
    # Powers of two and integers: exact in float64.
    np.testing.assert_array_equal(morton_codes(points), morton_codes(points * 4 + 32))


def test_one_place_and_no_points():
    assert len(morton_codes(np.zeros((0, 3)))) == 0
    assert len(np.unique(morton_codes(np.full((5, 3), 7.0)))) == 1


def test_outliers_do_not_cost_resolution():
    points = np.random.default_rng(1).uniform(size=(1000, 3))
    points[0] = 1e30
    assert len(np.unique(morton_codes(points))) > 950
