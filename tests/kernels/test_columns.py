import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree.kernels.cpu import columns as cpu
from splatree.kernels.reference import columns as reference

SCALARS = ["<i1", "<u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8"]


@given(st.lists(st.sampled_from(SCALARS), min_size=1, max_size=12), st.sampled_from([0, 1, 5, 1025, 3000]), st.data())
def test_deinterleave_is_the_reference_for_any_record(kinds, num_rows, draw):
    rng = np.random.default_rng(num_rows)
    names = [f"p{i}" for i in range(len(kinds))]
    records = np.zeros(num_rows, list(zip(names, kinds, strict=True)))
    for name in names:
        records[name] = rng.integers(0, 120, num_rows)
    order = draw.draw(st.permutations(names))
    fields = [order[:2], order[2:5]] if len(order) > 2 else [order]
    found, wanted = ([np.full((num_rows, len(f)), -1, np.float32) for f in fields] for _ in range(2))
    cpu.deinterleave(records, fields, found, threads=2)
    reference.deinterleave(records, fields, wanted)
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_column_outside_of_the_record_is_refused():
    out = np.zeros((2, 1), np.float32)
    for offset, rows in ((-1, 16), (5, 16), (2**40, 16), (0, 15)):
        with pytest.raises(ValueError, match="deinterleave"):
            cpu._core.deinterleave(np.zeros(rows, np.uint8), 8, np.array([offset]), np.array([6], np.uint8), [out], 1)


@given(st.lists(st.floats(width=32), max_size=40), st.integers(0, 2))
def test_largest_magnitude_is_the_reference(values, threads):
    array = np.array(values, np.float32)
    np.testing.assert_equal(
        cpu.largest_magnitude(array, threads=threads), reference.largest_magnitude(array, threads=threads)
    )


@pytest.mark.parametrize("value", [np.nan, -np.inf, -1e30])
def test_largest_magnitude_finds_one_value_anywhere_in_a_long_column(value):
    array = np.ones((1 << 18) + 77, np.float32)
    for row in (0, 1 << 18, len(array) - 1):
        array[row] = value
        np.testing.assert_equal(cpu.largest_magnitude(array), float(np.abs(np.float32(value))))
        array[row] = 1
