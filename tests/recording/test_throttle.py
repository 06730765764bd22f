"""Oracles: the definition, checked by brute force over random histories."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from robocar.recording.throttle import Throttle

HISTORIES = st.lists(st.tuples(st.floats(0.01, 1.0), st.integers(0, 3)), min_size=1, max_size=60)


@given(HISTORIES)
def test_writings_keep_their_distance_and_the_newest_is_written_in_the_end(history):
    throttle = Throttle(0.2, 100.0, size=lambda value: 50 * value[1])
    time, written, newest = 0.0, [], None
    for step, size in history:
        time += step
        newest = (time, size)
        throttle.offer("a", newest)
        written += [(time, value) for _, value in throttle.due(time)]
    written += [(float("inf"), value) for _, value in throttle.due(float("inf"))]
    assert written[0][1] == (history[0][0], history[0][1])
    assert written[-1][1] == newest
    waits = [after - before for (before, _), (after, _) in pairwise(written)]
    needed = [max(0.2, 50 * value[1] / 100.0) for _, value in written[:-1]]
    assert all(wait >= need - 1e-9 for wait, need in zip(waits, needed, strict=True))
    stamps = [value[0] for _, value in written]
    assert stamps == sorted(set(stamps))


def test_the_same_object_is_written_once():
    throttle = Throttle(0.0, 1.0, size=lambda value: 0)
    plan = object()
    throttle.offer("plan", plan)
    assert throttle.due(0.0) == [("plan", plan)]
    throttle.offer("plan", plan)
    assert throttle.due(1.0) == []


def test_names_do_not_wait_for_each_other():
    throttle = Throttle(10.0, 1.0, size=lambda value: 0)
    throttle.offer("a", "first")
    assert throttle.due(0.0) == [("a", "first")]
    throttle.offer("b", "other")
    throttle.offer("a", "second")
    assert throttle.due(1.0) == [("b", "other")]
    assert throttle.due(10.0) == [("a", "second")]
