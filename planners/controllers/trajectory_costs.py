"""Trajectories of the car a few seconds ahead, and what they cost: shared by the controllers that sample velocities.

Everything in here is in grid coordinates: lengths in cells, speeds in cells per second (`GridMap.grid_from_world`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import LETHAL, SE2, Array, Belief, Controller, Costmap, Goal, Observation, Path, State
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.geometry.line_of_sight import segment_cost
from robocar.planners.geometry.outlines import CostmapView
from robocar.planners.geometry.polyline import nearest_on_path, point_ahead
from robocar.planners.tracking.moving_obstacles import STAY, depth_later, encounter

COLLIDES, COST, GOAL, PATH, TRAVELLED, TURNED, HEADING, DEPTH, CLOSE = range(9)
"""Columns of what `rollouts` finds."""

NEVER = 1_000_000  # steps
_HIGHEST = 252.0  # cost of a cell that may be entered
_OPEN = np.zeros((0, 0), dtype=np.uint8)  # a world without obstacles
_OPEN.flags.writeable = False
_CHECKED = 0.5  # [cells] the outline is checked whenever a corner of it may have moved this far


class RobotBody(NamedTuple):
    """The robot in grid coordinates.

    Args:
        vertices: of its outline, (m, 2) [cells]; without any, nothing is touched.
        radius: how far the outline reaches from the centre [cells].
        safe_cost: see `outline_cost`.
        walled: whether it touches what lies beyond the costs (`Costmap.walled`).
    """

    vertices: Array
    radius: float
    safe_cost: float
    walled: bool


class RolloutAim(NamedTuple):
    """Where trajectories are to lead.

    Args:
        path: polyline to keep to, (k, 2) [cells].
        goal: point to come near to, (2,) [cells].
        forward: the point that is to come near to the goal lies this far ahead of the robot's centre [cells].
    """

    path: Array
    goal: Array
    forward: float


class RolloutHorizon(NamedTuple):
    """How far trajectories reach.

    Args:
        dt: time of a step [s].
        steps: their number.
        soon: the step after which the heading is compared with the goal's direction.
        brake: the step from which on the robot slows down and stands; `NEVER` for none.
        stay: how long a trajectory must not be met after its end, where the robot stands [s].
    """

    dt: float
    steps: int
    soon: int
    brake: int
    stay: float = STAY


@njit(cache=True)
def outline_cost(costs: NDArray, x: float, y: float, theta: float, vertices: Array, safe_cost: float, walled: bool) -> float:
    """Cost under the robot's centre, 0 to 252, or inf where its outline touches a lethal or unknown cell.

    Args:
        vertices: (n, 2) [cells]; without any, nothing is touched.
        safe_cost: below it, nothing is near enough to touch, however the robot is turned, and the outline is not checked.
        walled: see `RobotBody`.
    """
    rows, cols = costs.shape
    row, col = math.floor(y), math.floor(x)
    cost, inside = 0.0, 0 <= row < rows and 0 <= col < cols
    if inside:
        cost = float(costs[row, col])
        if cost < safe_cost:
            return cost
    if len(vertices) > 0 and (cost >= LETHAL or not footprint_free(costs, x, y, theta, vertices, walled)):
        return math.inf
    return min(cost, _HIGHEST)


@njit(cache=True)
def toward(value: float, target: float, step: float) -> float:
    """`value` moved towards `target` by at most `step`."""
    return min(max(target, value - step), value + step)


@njit(cache=True)
def path_distance(path: Array, x: float, y: float) -> float:
    """Distance from a point to a polyline (n, 2), n >= 1."""
    best = math.hypot(path[0, 0] - x, path[0, 1] - y)
    best *= best
    for i in range(len(path) - 1):
        ax, ay = path[i, 0], path[i, 1]
        dx, dy = path[i + 1, 0] - ax, path[i + 1, 1] - ay
        squared = dx * dx + dy * dy
        share = 0.0
        if squared > 0.0:
            share = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / squared))
        ex, ey = ax + share * dx - x, ay + share * dy - y
        best = min(best, ex * ex + ey * ey)
    return math.sqrt(best)


@njit(cache=True)
def rollouts(
    costs: NDArray, start: Array, limits: Array, samples: Array, body: RobotBody, aim: RolloutAim, horizon: RolloutHorizon,
    movers: Array,
) -> Array:  # fmt: skip
    """Drives towards each sampled twist with the car's accelerations, then on with it, until the time is over or it collides.

    Args:
        start: x, y, theta and the present v, omega, (5,).
        limits: accelerations of v and omega, (2,).
        samples: twists v, omega, (n, 2).
        movers: discs that move (`robocar.planners.tracking.moving_obstacles`), (m, 5).

    Returns:
        (n, 9), columns named above: 1 where the outline touches something; mean cost of the cells crossed, 0 to 252; smallest
        distance to the goal; distance of the end from the path; way until it ends or collides; angle turned until then [rad];
        angle between the heading after step `soon` and the direction of the goal [rad];
        depth in the room of movers, in the mean over what is looked at, 0 where it keeps out of it (it is taken to stand for
        `stay` after its end); and how much closer than now it comes to it before its end, counting the less the later, 0 to 1.
    """
    n, dt, steps, goal = len(samples), horizon.dt, horizon.steps, aim.goal
    terms = np.zeros((n, 9))
    whole = steps * dt + horizon.stay
    close_now = encounter(movers, 0.0, start[0], start[1])[1]
    dv, dw = limits[0] * dt, limits[1] * dt
    for k in range(n):
        x, y, theta, v, w = start[0], start[1], start[2], start[3], start[4]
        total, nearest, way, turned, moved = 0.0, math.inf, 0.0, 0.0, 0.0
        ahead_x, ahead_y = x, y
        for i in range(steps):
            share = 1.0 if i < horizon.brake else 0.0
            v, w = toward(v, share * samples[k, 0], dv), toward(w, share * samples[k, 1], dw)
            middle = theta + 0.5 * w * dt
            c, s = math.cos(middle), math.sin(middle)
            x, y, theta = x + v * dt * c, y + v * dt * s, theta + w * dt
            moved += abs(v * dt) + body.radius * abs(w * dt)
            check = moved > _CHECKED or i == steps - 1
            if check:
                moved = 0.0
            cost = outline_cost(costs, x, y, theta, body.vertices, body.safe_cost if check else 256.0, body.walled)
            if cost == math.inf:
                terms[k, 0] = 1.0
                break
            if len(movers) > 0:
                depth, closeness = encounter(movers, (i + 1) * dt, x, y)
                terms[k, 7] += depth * dt / whole
                terms[k, 8] = max(terms[k, 8], closeness * (1.0 - 0.5 * i / steps) - close_now)
            total += min(cost, 252.0)
            way += abs(v * dt)
            turned += abs(w * dt)
            ahead_x, ahead_y = x + aim.forward * c, y + aim.forward * s
            dx, dy = goal[0] - ahead_x, goal[1] - ahead_y
            nearest = min(nearest, dx * dx + dy * dy)
            if i == horizon.soon - 1:
                dx, dy, c, s = goal[0] - x, goal[1] - y, math.cos(theta), math.sin(theta)
                terms[k, 6] = abs(math.atan2(c * dy - s * dx, c * dx + s * dy))
        if terms[k, 0] == 0.0:
            terms[k, 7] += depth_later(movers, steps * dt, horizon.stay, 2.0 * dt, x, y) * 2.0 * dt / whole
        terms[k, 1] = total / steps
        terms[k, 2] = math.sqrt(nearest)
        terms[k, 3] = path_distance(aim.path, ahead_x, ahead_y)
        terms[k, 4], terms[k, 5] = way, turned
    return terms


@njit(cache=True)
def drawn(start: Array, limits: Array, samples: Array, dt: float, steps: int) -> Array:
    """Positions along the trajectories of `rollouts`, collisions or not, (n, steps + 1, 2)."""
    points = np.empty((len(samples), steps + 1, 2))
    for k in range(len(samples)):
        x, y, theta, v, w = start[0], start[1], start[2], start[3], start[4]
        points[k, 0] = x, y
        for i in range(steps):
            v, w = toward(v, samples[k, 0], limits[0] * dt), toward(w, samples[k, 1], limits[1] * dt)
            middle = theta + 0.5 * w * dt
            x, y, theta = x + v * dt * math.cos(middle), y + v * dt * math.sin(middle), theta + w * dt
            points[k, i + 1] = x, y
    return points


@dataclass(frozen=True, slots=True, eq=False)
class LocalPath:
    """The part of a path that lies just ahead of the robot, in grid coordinates.

    Args:
        points: from the robot's nearest point on, (n, 2) [cells].
        goal: the farthest point of it in sight within the lookahead, (2,) [cells].
        bearing: of the path a little ahead, against the robot's heading [rad].
        left: way to the path's end [cells].
    """

    points: Array
    goal: Array
    bearing: float
    left: float


def here(view: CostmapView) -> LocalPath:
    """Nowhere to go: for a robot that only gets out of the way."""
    place = np.array([view.x, view.y])
    return LocalPath(place[None], place, 0.0, 1.0 / view.resolution)


@njit(cache=True)
def _in_sight(
    costs: NDArray, points: Array, segment: int, share: float, x: float, y: float, lookahead: float
) -> tuple[float, float, float]:
    """The farthest of the points at 1, 5/6 ... 1/6 of the lookahead to which the straight way is free; and the way left."""
    gx, gy, left = x, y, 0.0
    for k in range(6, 0, -1):
        gx, gy, left = point_ahead(points, segment, share, lookahead * k / 6.0)
        if costs.size == 0 or segment_cost(costs, x, y, gx, gy) < math.inf:
            break
    return gx, gy, left


class PathFollower:
    """Where the robot is along its path; keeps its place, so that a path that comes back near itself is not cut short."""

    def __init__(self) -> None:
        self._path: object = None
        self._segment = 0

    def ahead(
        self, path: Path | None, end: Array, costmap: Costmap | None, view: CostmapView, lookahead: float, turn_ahead: float
    ) -> LocalPath:
        """The path just ahead, in the grid coordinates of the view.

        Args:
            path: None is the straight way to `end`, (2,) [m].
            lookahead: to the local goal [m]; turn_ahead: to where the bearing is taken [m].
        """
        if path is not self._path:
            self._path, self._segment = path, 0
        points = np.array([end]) if path is None else np.array(path.points)
        if costmap is not None:
            points = costmap.grid_from_world(points)
        if path is None:
            points, self._segment = np.concatenate([[[view.x, view.y]], points]), 0
        lookahead, turn_ahead = lookahead / view.resolution, turn_ahead / view.resolution
        self._segment, share, _ = nearest_on_path(points, self._segment, view.x, view.y, 1.5 * lookahead)
        costs = view.costs if costmap is not None else _OPEN
        gx, gy, left = _in_sight(costs, points, self._segment, share, view.x, view.y, lookahead)
        bx, by, _ = point_ahead(points, self._segment, share, turn_ahead)
        dx, dy = bx - view.x, by - view.y
        bearing = math.remainder(math.atan2(dy, dx) - view.theta, math.tau) if dx or dy else 0.0
        return LocalPath(_stretch(points, self._segment, share, 1.5 * lookahead), np.array([gx, gy]), bearing, left)


@njit(cache=True)
def _stretch(points: Array, segment: int, share: float, length: float) -> Array:
    """The path from a point of it on, for `length` (to the end of the segment there), (n, 2)."""
    out = np.empty((len(points) - segment + 1, 2))
    a, b = points[segment], points[min(segment + 1, len(points) - 1)]
    out[0, 0], out[0, 1] = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
    n, way = 1, 0.0
    for i in range(segment + 1, len(points)):
        out[n] = points[i]
        way += math.hypot(out[n, 0] - out[n - 1, 0], out[n, 1] - out[n - 1, 1])
        n += 1
        if way > length:
            break
    return out[:n].copy()


def exercise(build: Callable[[], Controller]) -> None:
    """All that such a controller does in the control loop: choosing, turning to the path and at the goal, drawing."""
    open_ground = Costmap(np.zeros((60, 60), dtype=np.uint8), 0.05, SE2(-1.0, -1.0))
    path = Path(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]))
    goal = Goal(np.array([1.0, 0.0]), 1.0)
    for pose, costmap in ((SE2(), open_ground), (SE2(0.0, 0.0, 1.5), open_ground), (SE2(1.0), None), (SE2(), None)):
        dict(build().command(State.of(Belief(pose)), path, costmap, Observation(0.0), goal).trace)
