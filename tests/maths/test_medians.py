"""Medians by passes are those of NumPy."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from splatree.maths import medians
from splatree.maths.medians import median_of

FLOATS = some.floats(allow_nan=False, allow_infinity=False, width=32)


@given(some.lists(FLOATS, min_size=1, max_size=40), some.integers(1, 7), some.sampled_from([0, 1, 3]))
def test_a_median_by_passes_is_that_of_numpy(values, size, room):
    array = np.array(values, np.float32)

    def chunks():
        return (array[begin : begin + size] for begin in range(0, len(array), size))

    with mock.patch.object(medians, "ROOM", room), mock.patch.object(medians, "NUM_BINS", 4):
        found = median_of(chunks, len(array))
    assert found == np.median(array.astype(np.float64))


@pytest.mark.parametrize(
    "values", [np.repeat([-1.0, 2.0], 50), np.zeros(100), np.r_[np.zeros(50), 1e-300, 1e300], np.r_[-0.0, 0.0, -0.0]]
)
def test_equal_values_and_wide_gaps_end(values):
    with mock.patch.object(medians, "ROOM", 2):
        assert median_of(lambda: [values], len(values)) == np.median(values)
