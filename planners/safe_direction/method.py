"""The method of safe-direction navigation without motion: its parameters, and from what is seen to a direction (Trihatmo)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robocar.core import SE2, Array, Robot
from robocar.planners.safe_direction.fan import Choice, Fan, choose, directions, fan, shortest_direction
from robocar.planners.safe_direction.view import DirectionPanorama, Readings, Sector, mark, window
from robocar.planners.search.transforms import METRICS, descend, goal_seeds, grown, nearest_blocked, obstacle_transform, spread

DOUBT, DOUBT_SHARE = 0.1, 0.02  # [m, 1] by which a way may seem shorter than an earlier bound: errors of cells and readings
_MOST_GAPS = 12  # that are closed at most to find a way that is long enough
_ROOM = 1.5  # [cells] more than its growth, the place of the robot itself that counts as seen
JOINED = 0.12  # [m] hits no farther apart are one surface; wider gaps that are too narrow for the car close as obstacles grow


@dataclass(frozen=True, slots=True)
class SafeDirectionParameters:
    """
    Args:
        alpha: the safety factor: 0 shortest, 1 safest (eq. 6).
        delta: how large N of the shortest direction has to be, as a share of the safest one's, for alpha to be 0 (eq. 15); at 1
            the rule is off. The paper gives no value.
        number_of_directions: of the fan over the sector (eq. 1).
        view_angle: opening angle of the sector ahead that is looked at, at most the sensor's [rad].
        max_range: r_max, up to which readings count, at most the sensor's [m].
        safe_range: up to which cells count for N [m]; the paper leaves this limit open, or takes r_max. The shorter, the quicker
            the car comes back to the middle.
        resolution: of the local grids [m].
        metric: of the distance transform: euclidean, octile or jarvis.
        safe_sector: opening angle around the shortest direction in which the safest one is sought [rad]; 2 pi: anywhere in the
            sector, as in the paper, which looks ahead only.
        padding: by which obstacles are grown beyond the robot's circumscribed radius [m].
        step_share, max_step: the local target lies this share of the free way ahead, at most so far [1, m] (eq. 9).
        carry_bound: whether one number is remembered, a lower bound of the way left to the goal, so that a way which was seen to
            be closed is not tried again when it is out of sight. The paper remembers nothing.
        approach_distance: a goal so near, with a free way to it, is driven to straight [m].
        obstacle_speed: what comes towards the robot is taken to come this fast [m/s].
        wait_time: without any way the robot stands so long before it gives up [s].
        patience: way driven without covering new ground, at which it says that it is stuck [m]; a turn counts 0.15 m/rad.
        memory_size: side of the grid that the variant with a memory keeps [m].
    """

    alpha: float = 0.6
    delta: float = 0.95
    number_of_directions: int = 181
    view_angle: float = math.tau
    max_range: float = 3.0
    safe_range: float = 1.0
    resolution: float = 0.05
    metric: str = "euclidean"
    safe_sector: float = math.pi
    padding: float = 0.02
    step_share: float = 0.7
    max_step: float = 1.0
    carry_bound: bool = True
    approach_distance: float = 0.6
    obstacle_speed: float = 0.3
    wait_time: float = 8.0
    patience: float = 15.0
    memory_size: float = 12.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.alpha <= 1.0:
            raise ValueError(f"alpha, the safety factor, goes from 0 to 1, not {self.alpha}")
        if not 0.0 < self.delta <= 1.0:
            raise ValueError(f"delta goes from above 0 to 1 (the rule is off), not {self.delta}")
        if not 3 <= self.number_of_directions <= 3600:
            raise ValueError(f"number_of_directions goes from 3 to 3600, not {self.number_of_directions}")
        for name in ("view_angle", "safe_sector"):
            if not 0.0 < getattr(self, name) <= math.tau * (1.0 + 1e-6):
                raise ValueError(f"{name} goes from above 0 to 2 pi, not {getattr(self, name)}")
        if self.metric not in METRICS:
            raise ValueError(f"metric must be one of {', '.join(METRICS)}, not {self.metric!r}")
        if not 0.01 <= self.resolution <= 0.2:
            raise ValueError(f"resolution goes from 0.01 to 0.2 m, not {self.resolution}")
        if not 0.5 <= self.max_range <= 200 * self.resolution:
            raise ValueError(f"max_range goes from 0.5 m to 200 cells ({200 * self.resolution:g} m), not {self.max_range}")
        if not self.max_range <= 0.5 * self.memory_size <= 500 * self.resolution:
            raise ValueError(
                f"memory_size goes from twice max_range ({2 * self.max_range:g} m) to 1000 cells ({1000 * self.resolution:g} m), "
                f"not {self.memory_size}"
            )
        if not 0.0 < self.step_share < 1.0:
            raise ValueError(f"step_share lies between 0 and 1 (the local target before the contact), not {self.step_share}")
        for name in ("max_step", "patience", "safe_range"):
            if not 0.1 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be at least 0.1 m, not {getattr(self, name)}")
        for name in ("padding", "approach_distance", "obstacle_speed", "wait_time"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must not be negative, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """What a look around says: the models, the transforms on them, the fan and the choice.

    Args:
        seen: the two readings of the scan.
        clearance: obstacle transform of the pessimistic one, obstacles grown, (rows, cols) [cells].
        distance: distance transform of the optimistic one, obstacles grown, (rows, cols) [cells].
        fan: over the pessimistic model.
        choice: None where no way to the goal is in sight.
    """

    seen: Readings
    clearance: Array
    distance: Array
    fan: Fan
    choice: Choice | None


class Directions:
    """The method itself, without motion: from what is seen to a direction.

    The car needs its circumscribed radius to turn anywhere. Where nothing but gaps too narrow for that is in sight, its inscribed
    radius will do: it can pass straight.
    """

    def __init__(self, robot: Robot, sector: Sector, parameters: SafeDirectionParameters) -> None:
        self.sector, self.parameters = sector, parameters
        outline = robot.footprint
        self._growths = [
            (radius + parameters.padding) / parameters.resolution
            for radius in (outline.circumscribed_radius, outline.inscribed_radius)
        ]  # [cells]
        self._body = self._growths[0] + _ROOM
        self._join = JOINED / parameters.resolution

    def readings(self, pose: SE2, panorama: DirectionPanorama) -> Readings:
        """The panorama on cells around `pose` (world_from_robot)."""
        p = self.parameters
        grid = window(pose, self.sector.reach, p.resolution)
        free, occupied = np.zeros(grid.shape, dtype=np.bool_), np.zeros(grid.shape, dtype=np.bool_)
        x, y = (v / p.resolution for v in grid.origin.inverse_apply(pose.x, pose.y))
        mark(panorama.ranges, panorama.hit, panorama.surface, x, y, 1.0 / p.resolution, self._body, self._join, free, occupied)
        return Readings(grid, free, occupied, x, y)

    def decide(self, seen: Readings, heading: float, goal: Array, bound: float = 0.0) -> Decision:
        """The direction to go, for a robot that looks along `heading` [rad] and wants to get to `goal` (2,) [m].

        Args:
            bound: what the way to the goal is at least, as known from before [m].
        """
        p, r = self.parameters, self.parameters.resolution
        row, col = int(seen.y), int(seen.x)
        # Distances between centres, less half a cell: to the obstacle's edge.
        room = obstacle_transform(~seen.free)
        room -= 0.5
        beside = nearest_blocked(seen.occupied, (row, col)) - 0.5
        headings = directions(heading, self.sector.width, p.number_of_directions)
        gx, gy = (v / r for v in seen.grid.origin.inverse_apply(*goal))
        clearance, distance, found, choice = room, room, None, None
        for growth in self._growths:
            # Nearer to an obstacle than that, the robot leaves it as if it were slimmer.
            slim = max(0.0, min(growth, float(room[row, col]) - 0.5))
            clearance = room - slim
            # Shortest ways touch what they go round; the fan's first steps there must be free.
            blocked = grown(seen.occupied, 0.5 + max(0.0, min(growth + 0.5, beside - 0.5)))
            distance = self._distance(blocked, (gx, gy), (row, col))
            if slim == growth == self._growths[0]:
                distance = self._consistent(distance, blocked, seen, (gx, gy), bound / r)
            found = fan(headings, clearance, (seen.x, seen.y), self.sector.reach, r, self.sector.whole, p.safe_range)
            shortest = shortest_direction(distance, seen.x, seen.y, (gx, gy), self.sector.reach / r)
            if shortest is None:
                continue
            outside = abs(math.remainder(shortest - heading, math.tau)) > 0.5 * self.sector.width
            barrier = min(p.max_step, self.sector.reach)
            choice = choose(found, shortest, outside, p.alpha, p.delta, p.safe_sector, barrier)
            break
        assert found is not None
        return Decision(seen, clearance, distance, found, choice)

    def _consistent(
        self, distance: Array, blocked: NDArray[np.bool_], seen: Readings, goal: tuple[float, float], bound: float
    ) -> Array:
        """The distance transform without ways that cannot be, as they are shorter than what is left of an earlier lower bound.

        A way over optimistic cells is never longer than the true one, so from a place d farther on at least that much less d is
        left. If the transform now promises less, it is because something has got out of sight that was seen to be closed. Then
        the gap where the promised way leaves what is in sight is closed, until the next way is long enough. If none is, the
        world has changed, and the first one counts.
        """
        row, col = int(seen.y), int(seen.x)
        least = bound - DOUBT_SHARE * bound - DOUBT / self.parameters.resolution
        if not distance[row, col] < least:
            return distance
        beside = cv2.dilate(seen.free.view(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
        edge = beside & ~seen.free & ~blocked  # of what is in sight, where it is not a surface
        _, gaps = cv2.connectedComponents(edge.view(np.uint8), connectivity=8)
        closed, now = blocked.copy(), distance
        for _ in range(_MOST_GAPS):
            way = descend(now, (row, col))
            crossed = gaps[way[:, 0], way[:, 1]]
            crossed = crossed[crossed > 0]
            if len(crossed) == 0:
                return distance
            closed |= gaps == crossed[0]
            now = self._distance(closed, goal, (row, col))
            if now[row, col] >= least:
                return now if math.isfinite(now[row, col]) else distance
        return distance

    def _distance(self, blocked: NDArray[np.bool_], goal: tuple[float, float], robot: tuple[int, int]) -> Array:
        """Distance transform from the goal, from the free cells nearest to it where it is blocked itself."""
        metric = self.parameters.metric
        seeds = goal_seeds(blocked, np.array([goal[1], goal[0]]), metric)  # type: ignore[arg-type]
        if len(seeds[0]) == 0:
            cells = np.argwhere(~blocked)
            away = np.hypot(cells[:, 0] + 0.5 - goal[1], cells[:, 1] + 0.5 - goal[0])
            nearest = np.argsort(away, kind="stable")[:1]
            seeds = cells[nearest], away[nearest]
        return spread(blocked, seeds, metric, robot)  # type: ignore[arg-type]
