"""Rows that are decoded some at a time."""

import numpy as np
import pytest

from splatree.io.rows import regrouped

from ..scenes import cloud


@pytest.mark.parametrize("num_rows", [1, 3, 7, 10, 25])
@pytest.mark.parametrize("sizes", [(10,), (1, 0, 9), (4, 4, 2), (3, 3, 3, 1)])
def test_regrouped_rows_are_those_of_the_chunks_so_many_at_a_time(num_rows, sizes):
    g = cloud(10, 3, degree=1)
    ends = np.cumsum(sizes)
    chunks = [g.rows(end - size, end) for size, end in zip(sizes, ends, strict=True)]
    found = [part.take(np.arange(len(part))) for part in regrouped(chunks, num_rows, 1)]
    assert [len(part) for part in found] == [min(num_rows, 10 - i) for i in range(0, 10, num_rows)]
    for name, column in vars(g).items():
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in found]), column)
