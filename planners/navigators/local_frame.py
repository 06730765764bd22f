"""What a controller is given in the frame of its costmap: `odom`, which a correction of the pose does not move."""

from __future__ import annotations

from dataclasses import replace

from robocar.core import SE2, Command, Goal, Path, State
from robocar.core.geometry import shift
from robocar.core.trace import transformed

_HERE = SE2()
_SHIFT = 0.025  # [m] within `_AROUND` of the robot that the estimate's correction has to move before it is followed
_AROUND = 1.0  # [m]


class LocalFrame:
    """Converts state, path and goal from `map` to `odom`, and traces back; nothing where the two are the same.

    The correction between the two jitters with the estimate. What is kept, costmaps and path, follows it in steps, and all of it
    by the same ones: a gap that is free in one costmap is free in the other, and controllers keep their place on a path.
    """

    def __init__(self) -> None:
        self._source: Path | None = None
        self._path: Path | None = None
        self.map_from_odom = _HERE
        """As followed so far."""

    def follow(self, state: State) -> SE2:
        """Takes in an estimate; returns the robot's pose in `map` by the correction as followed."""
        correction = state.map_from_odom
        if correction == _HERE or shift(self.map_from_odom, correction, state.odom_from_robot, _AROUND) > _SHIFT:
            self.map_from_odom, self._source = correction, None
        return state.belief.pose if correction == _HERE else self.map_from_odom @ state.odom_from_robot

    def state(self, state: State) -> State:
        """The state with the pose by odometry as its belief."""
        if state.map_from_odom == _HERE:
            return state
        return State(replace(state.belief, pose=state.odom_from_robot), _HERE, state.odom_from_robot, state.map, state.work)

    def path(self, path: Path, segment: int) -> Path:
        """What is left of a path, from the segment that the robot is on: the same object until a correction moves it."""
        if self.map_from_odom == _HERE:
            return path
        if path is not self._source:
            self._source = path
            self._path = Path(self.map_from_odom.inverse().transform(path.points[segment:]))
        assert self._path is not None
        return self._path

    def goal(self, goal: Goal, state: State) -> Goal:
        """The goal in `odom`."""
        if state.map_from_odom == _HERE:
            return goal
        odom_from_map = state.map_from_odom.inverse()
        heading = None if goal.heading is None else goal.heading + odom_from_map.theta
        return replace(goal, position=odom_from_map.transform(goal.position), heading=heading)

    def drawn(self, command: Command, state: State) -> Command:
        """A controller's command with its trace in the map frame."""
        if state.map_from_odom == _HERE or not command.trace:
            return command
        return replace(command, trace=transformed(command.trace, state.map_from_odom))
