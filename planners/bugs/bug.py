"""A bug as a controller: looks, has its strategy decide, and moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from robocar.core import (
    SE2,
    STOP,
    Array,
    Command,
    Context,
    Costmap,
    Drive,
    GiveUp,
    Goal,
    Observation,
    Path,
    Robot,
    State,
    Text,
    Twist,
    frozen_array,
    wrap_angle,
)
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.trace import Drawable
from robocar.planners.bugs.motion import Motion
from robocar.planners.bugs.open_points import VirtualCircle, find_open_points
from robocar.planners.bugs.view import (
    Along,
    BugParameters,
    BugView,
    Move,
    Stand,
    Strategy,
    To,
    first_free,
    free_way,
    narrow_gap,
    room_at,
)
from robocar.planners.geometry.escape import Escape
from robocar.planners.geometry.surfaces import REACH, lines
from robocar.planners.navigators.reactive import Reactive
from robocar.planners.tracking.panorama import Lookout, ScanPanorama, Surround, middle

STOPPING_SHARE = 0.5  # of the goal's tolerance: the belief may be off
NEW_HEADING = math.radians(10.0)  # a straight motion that differs by more is another iteration
_CRAMPED = "too close to turn: driving to where there is room"
_LOOKS = 5  # scans, taken standing, that a way out is looked for in
_ROOM = 0.03  # [m] free around the circumscribed circle, where it ends


class Bug:
    """A bug as a controller: what it sees, what its strategy decides, and the motion that carries it out.

    Args:
        robot: needs a laser or sonars all round, see `Surround`.
        strategy: decides.

    Raises:
        ParameterError: the robot does not look all round closely enough.
    """

    def __init__(self, robot: Robot, strategy: Strategy, parameters: BugParameters | None = None) -> None:
        self.parameters = p = parameters or BugParameters()
        self.circle = VirtualCircle.of(robot.footprint, p.safety_constant)
        self.strategy = strategy
        self._motion = Motion(robot, p)
        self._surround = Surround(robot, 2.0 * math.atan(self.circle.radius / p.detection_distance))
        _warm_up()
        self.iterations = self.turns = 0
        self._panorama: ScanPanorama | None = None
        self._hits = np.empty((0, 2))
        self._counted: Array | float | None = None
        self._note = ""
        self._arrived = False
        self._cramped = True  # until it has been seen that it can turn where it starts
        self._escape, self._lookout, self._walls = Escape(robot, _ROOM), Lookout(_LOOKS), np.empty((0, 4))
        self._gap = 2.0 * robot.footprint.inscribed_radius

    def command(self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal) -> Command:
        """The twist until the next scan; path and costmap are not needed."""
        pose = state.belief.pose
        panorama = self._surround.panorama(observation, pose)
        if panorama is not None and panorama.lost:
            self._panorama = None
            self._motion.stand(observation.time)
            return replace(STOP, trace=self._said("no beam has come back: standing"))
        if panorama is not None:
            self._panorama, self._hits = panorama, panorama.hits()
        if self._panorama is None:
            self._motion.stand(observation.time)
            return STOP
        centre = self.circle.centre(pose)
        # The circle's centre moves while the car turns on the spot: once there, the car's own place decides.
        near = goal.xy_goal_tolerance if self._arrived else 0.0
        self._arrived = math.dist(pose.position, goal.position) <= near
        self._arrived |= math.dist(centre, goal.position) <= STOPPING_SHARE * goal.xy_goal_tolerance
        if self._arrived:
            return Drive(self._align(pose, goal, observation.time))
        view = BugView(
            observation.time,
            pose,
            centre,
            self._panorama,
            self._hits,
            panorama is not None,
            goal,
            self._motion.blocked,
            self.circle,
            self.parameters,
        )
        if self._cramped and view.fresh and not self._escape.running:
            self._cramped = not self._motion.can_turn(pose, self._hits)
        if (out := self._get_out(view)) is not None:
            return replace(out, trace=dict(out.trace) | self._said(_CRAMPED))
        move = self.strategy.step(view)
        work = {"replans": 1} if self._is_new(move) else {}
        trace = self.strategy.trace(view) if view.fresh else {}
        if isinstance(move, GiveUp):
            return replace(move, trace=trace | dict(move.trace), work=work)
        twist = self._twist(move, view)
        trace |= self._said("")
        return Drive(twist, trace=trace, work=work)

    def _get_out(self, view: BugView) -> Drive | None:
        """Where the car cannot turn it stands, looks a few times, and drives to where it can; None elsewhere, and where that is
        in vain."""
        motion, escape, pose = self._motion, self._escape, view.pose
        if not (self._cramped or motion.cramped or escape.running):
            self._lookout.start()
            return None
        period = motion.period(view.time)
        if not escape.running:
            seen = self._lookout.look(view.panorama) if view.fresh else None
            if seen is None:
                return Drive(motion.stand(view.time))
            self._walls = lines(seen.hits(), pose, self._gap, REACH)
            escape.begin(pose, self._walls)
        drive = escape.command(pose, self._walls, period)
        if drive is None:
            self._cramped = motion.cramped = False
            motion.blocked = not motion.can_turn(pose, self._hits)
            return None
        if motion.opposed(pose, self._hits, drive.twist.v):
            drive = replace(drive, twist=Twist())
        motion.taken_over(drive.twist, view.time)
        return drive

    def _twist(self, move: To | Along | Stand, view: BugView) -> Twist:
        motion, time = self._motion, view.time
        if isinstance(move, Stand):
            return motion.stand(time)
        if isinstance(move, Along):
            return motion.drive(view.pose, self._hits, move.heading, math.inf, move.speed, time)
        axle = self.circle.axle(move.point, view.heading_to(move.point))
        left = math.dist(view.pose.position, axle)
        heading = math.atan2(axle[1] - view.pose.y, axle[0] - view.pose.x)
        return motion.drive(view.pose, self._hits, heading, left, self.parameters.desired_linear_vel, time)

    def _align(self, pose: SE2, goal: Goal, time: float) -> Twist:
        """At the goal: stand, or turn to its heading."""
        turn = 0.0 if goal.heading is None else wrap_angle(goal.heading - pose.theta)
        if abs(turn) <= STOPPING_SHARE * goal.yaw_goal_tolerance:
            return self._motion.stand(time)
        return self._motion.turn(pose, self._hits, pose.theta + turn, time)

    def _is_new(self, move: Move) -> bool:
        """Whether an iteration begins, a new straight motion: to another point, or along a heading more than 10 degrees away."""
        counted = self._counted
        if isinstance(move, To):
            new = not (isinstance(counted, np.ndarray) and np.array_equal(counted, move.point))
            self._counted = move.point
        elif isinstance(move, Along):
            new = not isinstance(counted, float) or abs(wrap_angle(counted - move.heading)) > NEW_HEADING
            self._counted = move.heading if new else counted
        else:
            return False
        self.iterations += new
        return new

    def _said(self, note: str) -> dict[str, Drawable]:
        """A line of the log, once."""
        new, self._note = note and note != self._note, note
        return {"bug": Text(note, "WARN")} if new else {}


@warm_up
def _warm_up() -> None:
    motion = Motion(trial_robot(), BugParameters())
    points = np.array([[0.5, 0.1], [0.5, -0.1], [0.1, 0.3]])
    free_way(points, 0.0, 0.0, 0.0, 0.1, 1.0)
    room_at(points, 0.0, 0.0)
    narrow_gap(points, 0.0, 0.0, 0.0, 1.0, 0.3, 0.1)
    first_free(points, 0.0, 0.0, 0.0, 1, 1.0, 0.1, 0.1, 0.1)
    for heading in (0.0, 2.0):
        motion.drive(SE2(), points, heading, 1.0, 0.1, 0.0)
    origin, bearings, ranges = (frozen_array(v) for v in (np.zeros(2), np.linspace(0.0, 6.0, 60), np.linspace(1.0, 6.0, 60)))
    panorama = ScanPanorama(0.0, origin, bearings, ranges, 6.0, 0.1)
    panorama.hits()
    find_open_points(middle([panorama, panorama]), 0.2, 0.01)


def build_bug(context: Context, strategy: Strategy) -> Reactive:
    """The navigator: the bug with this strategy for the context's robot, with its parameters."""
    return Reactive(Bug(context.robot, strategy, context.parameters_of(BugParameters)))
