"""Time to collision and closest approach. Oracles: closed forms by hand, and dense sampling of the two motions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar import run
from robocar.core import SE2, Footprint, Twist
from robocar.core.distance import polygon_distance
from robocar.metrics import Shape, Track
from robocar.metrics.movers import HORIZON, closest_approach, distance, min_time_to_collision, time_to_collision

CAR = Footprint.rectangle(0.10, 0.10, 0.09)
BOX = Shape(np.array([[0.2, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.2, -0.15]]))
POST = Shape(np.zeros((1, 2)), 0.25)


def ttc(
    twist: tuple[float, float], shape: Shape, pose: tuple[float, float, float], velocity: tuple[float, float, float]
) -> float:
    (time,) = time_to_collision(CAR, [[0.0, 0.0, 0.0]], [twist], Track(shape, [pose], [velocity]))
    return float(time)


@pytest.mark.parametrize(
    ("twist", "shape", "pose", "velocity", "seconds"),
    [
        ((0.3, 0), BOX, (2, 0, 0), (-0.2, 0, 0), 1.7 / 0.5),  # head-on: 0.10 + 0.20 of the 2 m are theirs
        ((0.3, 0), BOX, (2, 0, math.pi / 2), (-0.2, 0, 0), 1.75 / 0.5),  # the same, the box across: 0.10 + 0.15
        ((0.3, 0), POST, (2, 0, 0), (-0.2, 0, 0), 1.65 / 0.5),
        ((0.3, 0), POST, (1, 0, 0), (0.2, 0, 0), 0.65 / 0.1),  # caught up with
        ((0, 0), POST, (0, 1, 0), (0, -0.1, 0), (1 - 0.09 - 0.25) / 0.1),  # run into from the side, standing
        ((-0.2, 0), POST, (-1, 0, 0), (0, 0, 0), 0.65 / 0.2),  # backwards
        (
            (0.2, 0),
            BOX,
            (1, 1, 0),
            (0, -0.2, 0),
            0.76 / 0.2,
        ),  # crossing: its edge y = 0.85 comes down to 0.09, x overlaps by then
        ((0, 0.5), POST, (0, 0.40, 0), (0, 0, 0), None),  # turning on the spot, the corner passes 0.1345 from the centre
        ((0.3, 0), BOX, (2, 0.3, 0), (-0.2, 0, 0), None),  # they pass with 6 cm between them
        ((0.1, 0), POST, (1, 0, 0), (0.1, 0, 0), None),  # it never catches up
        ((0.3, 0), BOX, (-1, 0, 0), (0, 0, 0), None),  # behind
        ((0.0, 0), BOX, (0.25, 0, 0), (0, 0, 0), 0.0),  # overlapping, at rest
        ((0.1, 0), POST, (2, 0, 0), (0, 0, 0), None),  # 16.5 s ahead: beyond the horizon
    ],
)
def test_by_hand(twist, shape, pose, velocity, seconds) -> None:
    expected = math.inf if seconds is None else seconds
    assert ttc(twist, shape, pose, velocity) == pytest.approx(expected, abs=2e-3)


def test_a_corner_that_swings_into_a_post() -> None:
    """On the spot, the front left corner at hypot(0.10, 0.09) and atan2(0.09, 0.10) meets a post on +y: law of cosines."""
    reach, at, radius, gap = math.hypot(0.10, 0.09), math.atan2(0.09, 0.10), 0.25, 0.37
    meets = math.acos((reach**2 + gap**2 - radius**2) / (2 * reach * gap))
    expected = (math.pi / 2 - meets - at) / 0.5
    assert 0.3 < expected < 3.0
    assert ttc((0, 0.5), POST, (0, gap, 0), (0, 0, 0)) == pytest.approx(expected, abs=2e-3)


def test_along_an_arc() -> None:
    """A thin car on a circle of 1 m reaches a far-off small post on the circle after its arc less what the two are long."""
    needle = Footprint.rectangle(1e-4, 1e-4, 1e-4)
    pose = (math.sin(1.2), 1 - math.cos(1.2), 0.0)
    (time,) = time_to_collision(needle, [[0, 0, 0]], [(0.4, 0.4)], Track(Shape(np.zeros((1, 2)), 1e-3), [pose], [(0, 0, 0)]))
    assert time == pytest.approx(1.2 / 0.4, abs=5e-3)


numbers = st.floats(-1.0, 1.0)


@settings(max_examples=30, deadline=None)
@given(
    v=numbers, omega=numbers, theta=st.floats(-4, 4), x=st.floats(-2, 2), y=st.floats(-2, 2),
    velocity=st.tuples(numbers, numbers, numbers), shape=st.sampled_from([BOX, POST]),
)  # fmt: skip
def test_against_dense_sampling(v, omega, theta, x, y, velocity, shape) -> None:
    """Nothing touches at the instants before, moved by `SE2` and `Twist`, and something does at the time itself."""

    def gap(time: float) -> float:
        car = SE2(0.3, -0.2, 0.5) @ Twist(v, omega).step(time)
        mover = SE2(x + velocity[0] * time, y + velocity[1] * time, theta + velocity[2] * time)
        return polygon_distance(CAR.at(car), mover.transform(shape.outline)) - shape.radius

    (time,) = time_to_collision(CAR, [[0.3, -0.2, 0.5]], [(v, omega)], Track(shape, [(x, y, theta)], [velocity]))
    instants = np.linspace(0, HORIZON, 1001)
    gaps = np.array([gap(t) for t in instants])
    before = gaps[instants < time - 1e-9]
    assert np.all(before > 0)  # nothing touches earlier
    touches = [gap(time)] if math.isfinite(time) else [0.0]
    assert max(touches) < 2e-3  # and it does touch then
    assert math.isfinite(time) or gaps.min() > 0


def test_rows_that_are_not_finite_do_not_count() -> None:
    track = Track(POST, [[1, 0, 0], [math.nan, 0, 0], [2, 0, 0]], [[-0.1, 0, 0]] * 3)
    car = np.zeros((3, 3))
    times = time_to_collision(CAR, car, np.zeros((3, 2)), track)
    np.testing.assert_allclose(times, [6.5, math.nan, math.inf], atol=2e-3)
    np.testing.assert_allclose(distance(CAR, car, track), [0.65, math.nan, 1.65])
    tracks = {"a": track, "b": Track(BOX, [[-0.8, 0, 0]] * 3, [[0, 0, 0]] * 3)}
    assert min_time_to_collision(CAR, car, np.zeros((3, 2)), tracks) == pytest.approx(6.5, abs=2e-3)
    assert closest_approach(CAR, car, tracks) == pytest.approx(0.5)


def test_without_ticks_there_is_no_value() -> None:
    empty = Track(POST, np.empty((0, 3)), np.empty((0, 3)))
    assert min_time_to_collision(CAR, np.empty((0, 3)), np.empty((0, 2)), {"a": empty}) is None
    assert closest_approach(CAR, np.empty((0, 3)), {"a": empty}) is None


def test_a_run_with_a_cart_that_comes_towards_the_standing_car() -> None:
    """The cart drives at 0.2 m/s from 1.3 m ahead to 0.5 m ahead and stops: 0.5 less half of each is the closest approach."""
    cart = {"name": "cart", "box": [0.4, 0.3, 0.3], "motion": "stop-turn-go", "heading": math.pi, "pause": 60.0}
    scenario = {
        "map": "maps/thesis_field.yaml", "start": [0.5, 0.5, 0.0], "goal": [1.0, 0.5], "time_limit": 8.0,
        "movers": [cart | {"waypoints": [[1.8, 0.5], [1.0, 0.5]]}],
    }  # fmt: skip
    result = run(scenario, navigator="broken_parts:still", estimator="truth", seed=3)
    assert result.status == "timeout"
    assert result.value("movers/closest_approach") == pytest.approx(0.5 - 0.2 - 0.1, abs=0.012)
    # From its start 1.0 m away at full speed; just before it brakes it is nearest in time.
    assert result.value("movers/min_time_to_collision") == pytest.approx(0.2 / 0.2, abs=0.35)


@pytest.mark.parametrize(("speed", "status"), [(0.0, "timeout"), (0.05, "success")])
def test_a_mover_on_the_goal_is_waited_for(speed: float, status: str) -> None:
    """It stands there for ever, or creeps off: half of the box and of the car are clear of each other after 5 s."""
    cart = {"name": "cart", "box": [0.3, 0.3, 0.3], "waypoints": [[1.5, 0.5], [2.9, 0.5]], "speed": speed}
    scenario = {
        "map": "maps/thesis_field.yaml", "start": [0.5, 0.5, 0.0], "goal": [1.5, 0.5], "time_limit": 25.0, "movers": [cart],
        "robot": {"lidar": "scan360"}, "progress": {"movement_time_allowance": 5.0},
    }  # fmt: skip
    result = run(scenario, navigator="a-star", estimator="truth", seed=1)
    assert result.status == status
    assert status == "success" or result.reason == "not there after 25 s: mover 'cart' stands on the goal"
    assert result.value("contacts") == result.value("contacts_standing") == 0
    assert (result.value("duration") or 0.0) > 5.0
