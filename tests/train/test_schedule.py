"""What a run does when: the clock is read between rounds alone, and all else follows from numbers that are kept."""

from collections import Counter

import numpy as np
import pytest

from splatree.errors import InputError
from splatree.scene.gradients import Moments
from splatree.train.options import TrainOptions
from splatree.train.schedule import PIXELS_EACH, ROUND, Schedule, generator, rates, round_of

PIXELS = 10**9
"""Of photographs that can tell all Gaussians apart that are asked for."""


def rounds(options, seconds_a_step, *, steps=10**6):
    """The rounds of a run whose steps take these seconds."""
    found, step, spent = [], 0, 0.0
    while step < steps and (options.budget_s is None or spent < options.budget_s):
        last = found[-1] if found else None
        found.append(
            round_of(options, step, spent, last, 0 if last is None else last.num_steps * seconds_a_step(step - 1))
        )
        step += found[-1].num_steps
        spent += found[-1].num_steps * seconds_a_step(step - 1)
        if options.iterations is not None and step >= options.iterations:
            break
    return found, step, spent


@pytest.mark.parametrize("cost", [0.003, 0.05, 1.7])
def test_minutes_are_met_to_a_step(cost):
    found, _, spent = rounds(TrainOptions(minutes=1), lambda step: cost)
    assert 60 <= spent <= 60 + max(cost, 10 * cost if cost > 1 else cost)  # the first rounds are ten steps long
    assert [entry.step % ROUND == 0 for entry in found if entry.step > 30] == [True] * sum(e.step > 30 for e in found)
    shares = [entry.share for entry in found]
    assert shares == sorted(shares)


def test_a_step_that_becomes_dearer_is_noticed():
    _, _, spent = rounds(TrainOptions(minutes=1), lambda step: 0.02 if step < 800 else 0.06)
    assert 60 <= spent < 61


def test_iterations_need_no_clock():
    found, step, _ = rounds(TrainOptions(iterations=250), lambda step: np.nan)
    assert step == 250 and [entry.num_steps for entry in found] == [100, 100, 50]
    assert [entry.share for entry in found] == [0, 0.4, 0.8]


@pytest.mark.parametrize("num_views", [1, 7, 65])
def test_each_photograph_comes_once_an_epoch_in_another_order(num_views):
    schedule = Schedule(TrainOptions(), 1, 8, PIXELS)
    epochs = [[schedule.view(num_views * epoch + i, num_views) for i in range(num_views)] for epoch in range(3)]
    assert all(Counter(epoch) == Counter(range(num_views)) for epoch in epochs)
    assert num_views == 1 or epochs[0] != epochs[1] != epochs[2]
    other = Schedule(TrainOptions(seed=1), 1, 8, PIXELS)
    assert num_views < 7 or [other.view(i, num_views) for i in range(num_views)] != epochs[0]


def test_random_numbers_depend_on_what_they_are_for_alone():
    first = generator(1, "births", 300).random(4)
    np.testing.assert_array_equal(first, generator(1, "births", 300).random(4))
    for other in (generator(2, "births", 300), generator(1, "views", 300), generator(1, "births", 301)):
        assert not np.isin(first, other.random(4)).any()


def test_photographs_grow_and_are_never_smaller_than_they_may_be():
    shares = (0.0, 0.3, 0.6, 0.8)
    assert [Schedule(TrainOptions(), 1, 8, PIXELS).division(share) for share in shares] == [4, 2, 2, 1]
    assert [Schedule(TrainOptions(), 2, 8, PIXELS).division(share) for share in shares] == [4, 4, 2, 2]
    assert [Schedule(TrainOptions(), 1, 1, PIXELS).division(share) for share in shares] == [1, 1, 1, 1]
    assert [Schedule(TrainOptions(), 8, 8, PIXELS).division(share) for share in shares] == [8, 8, 8, 8]


def test_pictures_are_smaller_than_at_last_but_for_a_tree_that_grows():
    shares = (0, 0.3, 0.65, 1)
    assert [Schedule(TrainOptions(), 1, 8, PIXELS).times_smaller(share) for share in shares] == [4, 2, 2, 1]
    assert [Schedule(TrainOptions(), 2, 8, PIXELS).times_smaller(share) for share in shares] == [2, 2, 1, 1]
    grown = Schedule(TrainOptions(levels="grow"), 2, 8, PIXELS)
    assert [grown.times_smaller(share) for share in shares] == [1, 1, 1, 1]


def test_high_harmonics_come_late():
    schedule = Schedule(TrainOptions(degree=3), 1, 1, PIXELS)
    assert [schedule.sh_degree(share) for share in (0, 0.49, 0.5, 1)] == [1, 1, 3, 3]
    assert Schedule(TrainOptions(degree=0), 1, 1, PIXELS).sh_degree(0) == 0


def test_the_count_reaches_its_target_at_half_of_the_run():
    schedule = Schedule(TrainOptions(max_gaussians=1000), 2, 8, PIXELS)
    counts = [schedule.count_target(share, 100) for share in np.linspace(0, 1, 21)]
    assert counts[0] == 100 and counts[10:] == [1000] * 11 and counts == sorted(counts)


def test_small_photographs_hold_the_count_down_until_they_are_large():
    """At a quarter there are 16 times fewer pixels; the largest photographs are compared with as many as were asked for."""
    num_pixels = 16 * PIXELS_EACH * 400
    schedule = Schedule(TrainOptions(max_gaussians=1000), 2, 8, num_pixels)
    counts = [schedule.count_target(share, 100) for share in np.linspace(0, 1, 21)]
    assert counts[0] == 100 and counts[5:12] == [400] * 7 and counts[12:] == [1000] * 9
    assert counts == sorted(counts)
    assert schedule.count_target(0.5, 700) == 700  # what a run began with is not taken away
    assert Schedule(TrainOptions(max_gaussians=1000), 4, 4, num_pixels).count_target(0.5, 100) == 1000


def test_rates_fall_to_their_ends():
    moments = Moments.zeros(1, 4)
    begin, end = rates(0, 10, moments, 4), rates(1, 10, moments, 4)
    np.testing.assert_allclose(begin[[0, 3, 7, 10, 11, 14]], [4e-3, 1e-2, 5e-2, 0.25, 2.5e-2, 2.5e-3], rtol=1e-5)
    np.testing.assert_allclose(end[[0, 3, 7, 10, 11, 14]], [4e-5, 2e-3, 5e-3, 5e-2, 2.5e-3, 2.5e-4], rtol=1e-5)
    assert (begin[:23] > 0).all() and not begin[23:].any()


@pytest.mark.parametrize(
    "wrong",
    [
        {"minutes": 1, "iterations": 1}, {"minutes": 0}, {"iterations": 0}, {"max_gaussians": 0}, {"degree": 4},
        {"size": "1/3"}, {"held_out": 1}, {"seed": -1}, {"mode": "mip"}, {"minutes": float("nan")},
    ],
)  # fmt: skip
def test_options_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match="wanted"):
        TrainOptions(**wrong)
