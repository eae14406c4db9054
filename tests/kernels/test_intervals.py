from itertools import pairwise

import numpy as np
import pytest

from splatree.kernels.cpu.codec import intervals as cpu
from splatree.kernels.reference import intervals as reference


def squared_error(x, w, cuts):
    parts = [slice(a, b) for a, b in pairwise(cuts)]
    return sum(np.sum(w[p] * (x[p] - np.average(x[p], weights=w[p])) ** 2) for p in parts)


@pytest.mark.parametrize("offset", [0.0, 1e6])
@pytest.mark.parametrize("count", [1, 2, 9, 39, 40])
def test_intervals_are_as_good_as_those_of_the_reference(count, offset):
    rng = np.random.default_rng(count)
    x, w = offset + np.sort(rng.standard_t(2, 40)), rng.uniform(0.1, 1, 40)
    found, wanted = (k.best_intervals(x, w, count) for k in (cpu, reference))
    assert found[0] == 0 and found[-1] == 40 and (np.diff(found) > 0).all() and len(found) == count + 1
    # Several divisions may be equally good; sums of squares lose some last bits.
    np.testing.assert_allclose(squared_error(x, w, found), squared_error(x, w, wanted), rtol=1e-9, atol=1e-9)
