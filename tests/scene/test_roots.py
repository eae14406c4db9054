"""The state of growth at roots: parts of it, and that of several parts together."""

from dataclasses import replace

import numpy as np

from splatree.scene.roots import Roots


def state(n, num_sizes, grown=None):
    column = np.arange(n)
    return Roots(
        weights=column.astype(np.float32),
        visibilities=np.ones(n, np.float32),
        reaches=column.astype(np.float64),
        codes=column.astype(np.uint64),
        inputs=column.astype(np.int64),
        num_sizes=num_sizes,
        grown=grown,
        log_unit=0.5,
    )


def test_some_roots_keep_their_state():
    taken = state(5, 3, np.array([3, 1, 3, 2, 3], np.int32)).take(np.array([3, 1]))
    assert taken.inputs.tolist() == [3, 1] and taken.grown.tolist() == [2, 1]
    assert (taken.num_sizes, taken.log_unit) == (3, 0.5)


def test_states_of_the_same_size_stay_uncounted():
    joined = Roots.concatenate([state(2, 3), state(3, 3)])
    assert joined.grown is None and joined.num_sizes == 3
    assert joined.codes.tolist() == [0, 1, 0, 1, 2]


def test_roots_that_have_grown_to_other_sizes_are_told_apart():
    joined = Roots.concatenate([state(2, 3), state(1, 5), replace(state(2, 4), grown=np.array([1, 4], np.int32))])
    assert joined.num_sizes == 5
    assert joined.grown.tolist() == [3, 3, 5, 1, 4]
