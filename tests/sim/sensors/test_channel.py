"""When sensors read and when their readings arrive. Oracles: brute force in whole milliseconds, and the truth of then."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, Drive, Hold, Twist
from robocar.sim.fit_out import FitOut
from robocar.sim.sensors.channel import Channel
from tests.sim.rooms import drive, room
from tests.sim.sensors.exact import EXACT, TILT


def hand_outs(period: int, delay: int, tick: int, ticks: int) -> list[tuple[int, int]]:
    """Brute force in whole milliseconds: (time handed out, time taken) of a channel polled at every tick."""
    taken, expected, k = [], [], 0
    for now in range(0, ticks * tick, tick):
        if now >= k * period:
            taken.append(now)
            while k * period <= now:
                k += 1
        arrived = [t for t in taken if t + delay <= now]
        new = [t for t in arrived if t + delay > now - tick or now == 0]
        if new:
            expected.append((now, new[-1]))
    return expected


def polled(period: int, delay: int, tick: int, ticks: int) -> list[tuple[int, int]]:
    channel = Channel(period / 1000, delay / 1000, lambda time: round(1000 * time))
    time, found = 0.0, []
    for i in range(ticks):
        value = channel.poll(time)
        if value is not None:
            found.append((i * tick, value))
        time += tick / 1000  # as the physics does: rounding errors add up
    return found


@given(
    period=st.integers(1, 400),
    delay=st.integers(0, 700),
    tick=st.sampled_from([5, 10, 20, 50]),
)
def test_channels_take_when_due_and_hand_out_after_the_delay(period: int, delay: int, tick: int) -> None:
    """Also with periods that are no multiple of the tick, and delays longer than the period."""
    assert polled(period, delay, tick, 200) == hand_outs(period, delay, tick, 200)


def test_channels_by_hand() -> None:
    assert polled(100, 0, 50, 6) == [(0, 0), (100, 100), (200, 200)]
    assert polled(70, 0, 50, 8) == [(0, 0), (100, 100), (150, 150), (250, 250), (300, 300), (350, 350)]
    assert polled(50, 120, 50, 6) == [(150, 0), (200, 50), (250, 100)]
    assert polled(20, 0, 50, 3) == [(0, 0), (50, 50), (100, 100)]


def test_a_period_of_zero_is_every_tick() -> None:
    channel = Channel(0.0, 0.0, lambda time: time)
    assert [channel.poll(0.05 * i) for i in range(4)] == [0.05 * i for i in range(4)]


def test_after_hours_the_rate_still_holds() -> None:
    channel = Channel(0.1, 0.0, lambda time: time)
    taken = [i for i in range(200_000) if channel.poll(i * 0.05) is not None]
    assert taken == list(range(0, 200_000, 2))


def test_readings_carry_the_time_when_they_were_taken() -> None:
    """In the world: lidar every 100 ms, 120 ms late; the sonar at once."""
    sensors = EXACT | {"lidar": EXACT["lidar"] | {"delay": 0.12}}
    observations = drive(room(fit_out=FitOut(lidar="scan360"), sensors=sensors), Hold(), 1.0)
    scans = [(o.time, o.lidar.time) for o in observations if o.lidar is not None]
    assert scans == [pytest.approx((0.15 + 0.1 * i, 0.1 * i)) for i in range(9)]
    assert [scan.time for o in observations for scan in o.sonars] == [o.time for o in observations for _ in range(2)]


def test_delayed_readings_are_of_the_past() -> None:
    """A car that backs away from a wall: the late reading is the distance of then."""
    world = room(12, 8, start=SE2(10.9, 4), sensors=EXACT | {"sonar": EXACT["sonar"] | {"delay": 0.5}})
    distance = {}
    compared = 0
    for _ in range(60):
        observation = world.robot.sense()
        distance[round(world.time, 3)] = 12 - 0.10 - world.ground_truth().pose.x
        for scan in observation.sonars:
            assert observation.time - scan.time == pytest.approx(0.5)
            assert scan.ranges[0] == pytest.approx(distance[round(scan.time, 3)], abs=TILT)
            compared += 1
        world.robot.act(Drive(Twist(-0.2, 0.0)))
        world.step()
    assert compared == 2 * 50
    assert max(distance.values()) - min(distance.values()) > 0.4
