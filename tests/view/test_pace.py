"""How fast a page takes in what it is sent."""

import pytest

from splatree.view.pace import LEAD_S, STEP_S, Pace


def test_nothing_is_known_at_first_and_one_message_is_on_its_way():
    pace = Pace()
    assert pace.wait_s(9.0) == 0 and pace.step_bytes == float("inf")
    pace.send(1_000_000, 10.0)
    assert pace.wait_s(11.0) == float("inf")
    pace.acknowledge(1, 12.0)
    assert pace.wait_s(12.0) == 0 and pace.step_bytes == pytest.approx(STEP_S * 500_000)


def test_a_second_message_leaves_shortly_before_the_first_is_expected_to_be_taken_in():
    pace = Pace()
    pace.send(1_000_000, 10.0)
    pace.acknowledge(1, 12.0)
    pace.send(1_000_000, 20.0)  # takes 2 s again
    assert pace.wait_s(20.0) == pytest.approx(2 - LEAD_S) and pace.wait_s(22 - LEAD_S) == pytest.approx(0)
    pace.send(1_000_000, 22 - LEAD_S)
    assert pace.wait_s(22.0) == float("inf")  # two are on their way
    pace.acknowledge(2, 22.5)  # later than expected: the second one waited for it
    assert pace.wait_s(22.5) == pytest.approx(1_000_000 / 450_000 - LEAD_S)
    pace.send(100, 30.0)
    pace.acknowledge(3, 24.5)
    assert pace.wait_s(30.0) == 0  # a short one is taken in at once


def test_a_message_waits_for_the_one_before_it():
    """Two messages that leave together and arrive after 2 and 4 s: the line carries the same all the time."""
    pace = Pace()
    pace.send(100_000, 0.0)
    pace.acknowledge(1, 0.2)
    for _ in range(2):
        pace.send(1_000_000, 1.0)
    pace.acknowledge(2, 3.0)
    pace.acknowledge(3, 5.0)
    assert pace.step_bytes == pytest.approx(STEP_S * 500_000)


def test_short_messages_say_nothing_and_more_acknowledgements_than_messages_do_not_count():
    pace = Pace()
    pace.send(100, 0.0)
    pace.acknowledge(10**9, 9.0)
    assert pace.step_bytes == float("inf") and pace.wait_s(9.0) == 0
    pace.send(1_000_000, 10.0)
    pace.acknowledge(1, 10.5)
    assert pace.wait_s(10.5) == float("inf")  # the first one once more
    pace.acknowledge(2, 11.0)
    assert pace.step_bytes == pytest.approx(STEP_S * 1_000_000)


def test_a_line_that_gets_faster_is_believed_soon():
    pace = Pace()
    for i, rate in enumerate([1e5, 1e6, 1e6, 1e6]):
        pace.send(1_000_000, float(100 * i))
        pace.acknowledge(i + 1, 100 * i + 1e6 / rate)
    assert 0.85e6 < pace.step_bytes / STEP_S <= 1e6
