from splatree.progress import Event, listen, renamed, task, track


def test_without_a_listener_work_goes_on_unseen():
    assert list(track([1, 2, 3], "count")) == [1, 2, 3]


def test_listener_sees_each_step_and_the_end():
    events: list[Event] = []
    with listen(events.append):
        assert list(track("ab", "letters")) == ["a", "b"]
    assert [(e.done, e.total, e.finished) for e in events] == [
        (0, 2, False),
        (1, 2, False),
        (2, 2, False),
        (2, 2, True),
    ]


def test_what_was_done_before_counts_as_done():
    events: list[Event] = []
    with listen(events.append), task("goes on", 10, done=7) as advance:
        advance(2)
    assert [event.done for event in events] == [7, 9, 9]


def test_a_failed_task_is_reported_as_ended():
    events: list[Event] = []
    try:
        with listen(events.append), task("fails"):
            raise KeyError
    except KeyError:
        pass
    assert events[-1].finished


def test_tasks_can_be_renamed_for_the_listener():
    events: list[Event] = []
    with listen(events.append):
        with renamed(".a.tmp", "a.ply"), task("write .a.tmp"):
            pass
        with task("write .a.tmp"):
            pass
    assert [e.name for e in events] == ["write a.ply"] * 2 + ["write .a.tmp"] * 2
    with renamed("a", "b"):
        assert list(track([1], "unheard")) == [1]
