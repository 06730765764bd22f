"""Recovery behaviours: their order, what they do to the car, and that they begin only where a navigator gave up before."""

import math

import numpy as np
import pytest

from robocar.core import (
    SE2,
    STOP,
    Belief,
    Command,
    Costmap,
    Drive,
    GiveUp,
    Goal,
    NoPathFound,
    Observation,
    OccupancyGrid,
    Path,
    Scan,
    State,
    Text,
    Twist,
)
from robocar.planners.controllers import dwa, pure_pursuit
from robocar.planners.costmap.layered import CostmapParameters, inflate
from robocar.planners.navigators.plan_and_follow import EvasiveRecovery, PlanAndFollow, plan_and_avoid, plan_and_follow
from robocar.planners.navigators.recovery import Recovery, RecoveryParameters, Watch
from robocar.planners.search import a_star
from tests.planners.kinematic import DT, car, context, drive, sense, touches
from tests.planners.navigators.test_plan_and_follow import field

OPEN = inflate(field(80, 80), car().footprint.inscribed_radius, CostmapParameters(walled=False))
START = SE2(2.0, 2.0, 0.4)


def carry_out(name: str, costmap: Costmap = OPEN, start: SE2 = START, **parameters: float) -> tuple[list[SE2], list[Twist]]:
    """Poses and twists of one behaviour, without physics."""
    recovery = Recovery(car(), DT, RecoveryParameters(**parameters))  # type: ignore[arg-type]
    recovery.start(name, start, 0.0)
    poses, twists = [start], []
    for tick in range(1000):
        command = recovery.step(poses[-1], costmap, tick * DT)
        if command is None:
            return poses, twists
        twists.append(command.twist)
        poses.append(poses[-1] @ command.twist.step(DT))
    raise AssertionError("it never ends")


def test_backing_up_goes_straight_back_as_far_as_asked() -> None:
    poses, twists = carry_out("back_up", backup_dist=0.3)
    moved = START.inverse() @ poses[-1]
    assert moved.x == pytest.approx(-0.3, abs=0.02)
    assert (moved.y, moved.theta) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert min(t.v for t in twists) == pytest.approx(-0.1)
    steps = np.diff([0.0, *(t.v for t in twists), 0.0])
    assert np.abs(steps).max() <= car().limits.acc_lim_x * DT + 0.05 + 1e-9  # it ends within one step of creeping


def test_backing_up_ends_before_a_wall() -> None:
    """Exact: the wall's face is 0.2 m behind the car's rear; it stops before it, and well before the time is over."""
    world = field(80, 80, (0.0, 0.0, 1.0, 4.0))
    costmap = inflate(world, car().footprint.inscribed_radius, CostmapParameters(walled=False))
    poses, _ = carry_out("back_up", costmap, SE2(1.3, 2.0, 0.0), backup_dist=1.0)
    assert 1.0 < poses[-1].x - 0.1 < 1.15
    assert len(poses) * DT < 10.0


def test_spinning_turns_by_its_angle_on_the_spot() -> None:
    poses, _ = carry_out("spin", spin_dist=1.57)
    assert poses[-1].distance_to(START) == 0.0
    assert math.remainder(poses[-1].theta - START.theta, math.tau) == pytest.approx(1.57, abs=0.15)


def test_waiting_stands_for_its_time() -> None:
    poses, twists = carry_out("wait", wait_duration=3.0)
    assert set(twists) == {Twist()}
    assert len(twists) * DT == pytest.approx(3.0, abs=2 * DT)
    assert poses[-1] == START


def test_their_order_and_number() -> None:
    """Nav2's order, again and again; number_of_retries ends it; a robot that has got away begins anew."""
    recovery = Recovery(car(), DT, RecoveryParameters(number_of_retries=6, required_movement_radius=0.5))
    names = [recovery.next("why", SE2(), 0.0) for _ in range(7)]
    assert names == ["clear", "back_up", "spin", "wait", "clear", "back_up", None]
    assert recovery.next("why", SE2(0.6, 0.0), 0.0) == "clear"
    assert recovery.message == "recovery 1, clear: why"


def test_lost_progress_is_standing_within_a_radius_for_a_time() -> None:
    """By hand: 0.5 m within 10 s. A car that goes to and fro within 0.4 m makes none."""
    watch = Watch(RecoveryParameters())
    lost = [watch.lost_progress(SE2(0.2 + 0.2 * math.sin(t)), t) for t in np.arange(0.0, 12.0, 0.5)]
    assert lost.index(True) * 0.5 == 10.5
    watch = Watch(RecoveryParameters())
    assert not any(watch.lost_progress(SE2(0.06 * t), t) for t in np.arange(0.0, 30.0, 0.5))


class Blocked:
    """A controller that stands, or gives up."""

    def __init__(self, command: Command) -> None:
        self.answer = command

    def command(self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal) -> Command:
        return self.answer


def follower(local: Blocked, recover: bool) -> PlanAndFollow:
    plain = plan_and_follow(context(car(), field(80, 80), START), a_star.build, pure_pursuit.build)
    recovery = Recovery(car(), DT, RecoveryParameters(number_of_retries=4, movement_time_allowance=2.0, wait_duration=1.0))
    return PlanAndFollow(
        plain.global_planner,
        local,
        plain.costmap,
        plain.parameters,
        recovery=EvasiveRecovery(recovery, lambda *_: None) if recover else None,
    )


def texts(result: object) -> list[str]:
    """Different messages of the recovery, in order."""
    found = [trace["recovery"].message for trace in result.traces if "recovery" in trace]  # type: ignore[attr-defined]
    return list(dict.fromkeys(found))


@pytest.mark.parametrize("answer", [STOP, GiveUp("nothing will do", "stuck")], ids=["stands", "gives up"])
def test_every_behaviour_is_tried_and_told_before_it_gives_up(answer: Command) -> None:
    goal = Goal(np.array([3.5, 2.0]))
    result = drive(follower(Blocked(answer), True), car(), field(80, 80), START, goal, ticks=800)
    assert (result.status, result.reason.split(" (")[1]) == ("stuck", "after 4 recoveries)")
    assert [message.split(",")[1].split(":")[0].strip() for message in texts(result)] == ["clear", "back up", "spin", "wait"]
    assert min(twist.v for twist in result.twists) < 0.0
    assert max(twist.omega for twist in result.twists) > 0.5


def test_without_recovery_a_local_planner_s_word_ends_it() -> None:
    goal = Goal(np.array([3.5, 2.0]))
    result = drive(follower(Blocked(GiveUp("nothing will do", "stuck")), False), car(), field(80, 80), START, goal)
    assert (result.status, result.reason, result.twists) == ("stuck", "nothing will do", [])


def test_no_recovery_where_the_map_itself_has_no_way() -> None:
    """A wall through the whole prior map: it gives up in the first tick with the planner's reason."""
    world = field(40, 80, (2.0, 0.0, 2.2, 2.0))
    navigator = plan_and_avoid(context(car(), world, SE2(0.5, 1.0)), a_star.build, dwa.build)
    result = drive(navigator, car(), world, SE2(0.5, 1.0), Goal(np.array([3.5, 1.0])))
    assert (result.status, result.twists) == ("no_path", [])
    assert "no way from (0.500, 1.000) to (3.500, 1.000)" in result.reason


def test_a_gate_that_opens_after_some_time_is_waited_for() -> None:
    """A gap of the prior is closed for 15 s: where `a-star` has given up, the recoveries hold out, and the goal is reached."""
    open_world = field(40, 80, (2.0, 0.0, 2.2, 0.7), (2.0, 1.3, 2.2, 2.0))
    closed = field(40, 80, (2.0, 0.0, 2.2, 2.0))
    start, goal = SE2(0.5, 1.0), Goal(np.array([3.5, 1.0]))
    plain = plan_and_follow(context(car(), open_world, start), a_star.build, pure_pursuit.build)
    assert drive(plain, car(), closed, start, goal).status == "stuck"  # nobody has proved that it stays closed
    navigator = plan_and_avoid(context(car(), open_world, start), a_star.build, dwa.build)
    pose, recovered = start, False
    for tick in range(1600):
        world = closed if tick * DT < 15.0 else open_world
        command = navigator.command(State.of(Belief(pose)), sense(car(), world, pose, tick * DT), goal)  # type: ignore[arg-type]
        assert isinstance(command, Drive), command
        recovered |= "recovery" in command.trace
        pose = pose @ command.twist.step(DT)
        assert not touches(car(), world, pose)
        if goal.reached(pose):
            break
    assert recovered
    assert goal.reached(pose)


def test_a_laser_that_stops_sending_stops_the_car() -> None:
    """Scans every 0.1 s for 2 s, then none: within 0.5 s (and the time to brake) it stands and says so; when they come again it
    goes on."""
    world, start, goal = field(60, 100), SE2(0.5, 1.5), Goal(np.array([4.5, 1.5]))
    navigator = plan_and_avoid(context(car(), world, start), a_star.build, dwa.build)
    bearings, pose, log = np.linspace(-1.5, 1.5, 60), start, []
    for tick in range(100):
        time = tick * DT
        sends = tick % 2 == 0 and (time <= 2.0 or time >= 4.0)
        scan = Scan(time, np.full(60, math.inf), bearings, 5.0) if sends else None
        command = navigator.command(State.of(Belief(pose)), Observation(time, lidar=scan), goal)  # type: ignore[arg-type]
        assert isinstance(command, Drive)
        log.append((time, command))
        pose = pose @ command.twist.step(DT)
    moving = [command.twist.v > 0.1 for _, command in log]
    assert moving[38]
    silent = [command for time, command in log if 2.51 < time < 4.0]
    assert [command.twist for command in silent] == [Twist()] * len(silent)
    message = silent[0].trace["recovery"]
    assert isinstance(message, Text)
    assert message.message == "no reading of the laser: standing"
    assert moving[-1]


def test_something_on_the_goal_is_waited_for() -> None:
    """A post stands on the goal for 40 s, and then is gone: the car never gives up, touches nothing and arrives."""
    prior, taken = field(60, 100), field(60, 100, (3.85, 1.45, 3.95, 1.55))
    start, goal = SE2(0.5, 1.5), Goal(np.array([3.9, 1.5]))
    navigator = plan_and_avoid(context(car(), prior, start), a_star.build, dwa.build)
    pose, waited = start, False
    for tick in range(2400):
        world: OccupancyGrid = taken if tick * DT < 40.0 else prior
        command = navigator.command(State.of(Belief(pose)), sense(car(), world, pose, tick * DT), goal)  # type: ignore[arg-type]
        assert isinstance(command, Drive), command
        message = command.trace.get("recovery")
        waited |= isinstance(message, Text) and "something stands on the goal" in message.message
        pose = pose @ command.twist.step(DT)
        assert not touches(car(), world, pose)
        if goal.reached(pose):
            break
    assert waited
    assert goal.reached(pose)


@pytest.mark.parametrize("name", ["backup_dist", "rotational_vel", "wait_duration", "movement_time_allowance", "scan_timeout"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_wrong_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        RecoveryParameters(**{name: value})  # type: ignore[arg-type]


def test_planning_errors_carry_what_was_searched() -> None:
    """What a failing planner shows reaches the command that gives up."""
    assert NoPathFound("none", {"tree": Text("x")}).trace["tree"] == Text("x")
    assert dict(NoPathFound("none").trace) == {}
