"""Operative Critical Point Bug: a robot with dimension among stationary and moving obstacles.

Das, Dutta and Debnath, IJEECS 18(3), 2020, pp. 1646-1656: section 2.3, MAIN, OBSTACLE_DETECTION and SAFE_POINT. It knows its own
coordinates, those of its goal, and what a range sensor shows all round.

What the paper leaves open, and how it is decided here:

* An obstacle is *in direction* if the virtual circle, less half the safety constant (the noise), would touch it anywhere on the
  straight way to the goal that is in sight. The goal is then a sub-goal like others, nearer to itself than any: what keeps the
  circle from it may let the outline pass.
* Decisions are made standing, from the median of a few scans (the time spent on detecting, section 3.2), and checked at every
  scan on the way: where a way turns out blocked or a gap too narrow, the robot stops and decides anew, with what it saw there.
* SAFE_POINT asks all pairs of surface points on either side of the way, not open points alone (`bug_view.narrow_gap`), and that
  the circle fits at its end. Where a near corner keeps the robot from a sub-goal it sees, it goes beside that corner first: for
  a point it would not be in the way.
* *The same set* of open points, from which sub-goals are not calculated twice: an open point at the same place whose free side
  looks the same way. At a grazing angle the end is somewhere between what one beam hits and the next would: a known end in that
  stretch is the same, and keeps its place (`sub_goals.same_end`).
* Critical points are ranked by their distance to the goal as in the paper, but those of ends that are not sure, and those that
  the robot has driven by before, come after all others in sight. Else it follows walls to and fro, or goes back through doors.
* D keeps the safe sub-goals that were seen and not visited. Where none of those in sight is left, the robot looks a few times
  more, as noise may keep it from one, and then goes back along the points in T to where it saw the best that remains. Where
  there is none, it is `stuck`.
* Ends of walls that are seen at too grazing an angle to be sure of are open points too, until it has driven past them: beside a
  wall that it follows it sees no others. They are none where an earlier look has seen the wall go on (`surfaces`).
* Moving obstacles are not open points themselves; their virtual obstacles are. No way is taken on which a collision is predicted.
  Where no sub-goal is safe, or those beside virtual obstacles are farther from the goal than the robot, it waits if nothing comes
  towards it, else it gets out of the way, whatever the direction.
* Slip: the heading is corrected on the way.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from robocar.core import Array, Arrows, Context, GiveUp, Lines, Points, Text, declares, wrap_angle
from robocar.core.trace import PLAN_COLOR, Drawable
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.ocpb import collision_points, sub_goals
from robocar.planners.bugs.ocpb.collision_points import (
    Collision,
    Moving,
    StraightDrive,
    near_virtual,
    predict,
    standing_world,
    with_virtual,
)
from robocar.planners.bugs.ocpb.leg import Leg, LegKind
from robocar.planners.bugs.ocpb.parameters import OcpbParameters
from robocar.planners.bugs.ocpb.sub_goals import SAME
from robocar.planners.bugs.ocpb.traverse import Traverse
from robocar.planners.bugs.open_points import OpenPoint, open_point_rows, points_of
from robocar.planners.bugs.view import ARRIVED, BugParameters, BugView, Move, Stand, To, narrow_gap
from robocar.planners.navigators.reactive import Reactive
from robocar.planners.tracking.moving_obstacles import unseen
from robocar.planners.tracking.panorama import Lookout, ScanPanorama
from robocar.planners.tracking.tracker import ObstacleTracker

_TURN_DELAY = 0.3  # [s] to brake, look up and start
_EVADE = (0.3, 0.5, 0.8, 1.2)  # [m]
_PAUSE = 4.0  # [s] that nothing comes to a critical point
_STAY = 8.0  # [s] that nothing comes to where it has got out of the way
_FLAGS = 3  # scans in a row that have to say that a way is blocked
_SLACK = 0.5  # of the safety constant, by which single scans, noisier than those of a decision, may find less room
_LOOKS_AGAIN = 3
_TRIES = 4  # a way that was called free and turned out blocked this often is blocked


_ANGLES = np.linspace(0.0, math.tau, 33)
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


class OperativeCriticalPointBug:
    """The strategy.

    Args:
        parameters: its own; bug: those that all bugs share.
    """

    def __init__(self, parameters: OcpbParameters, bug: BugParameters) -> None:
        self.parameters = parameters
        self.obstacles = ObstacleTracker(parameters.max_obstacle_width, parameters.tracking_distance)
        self._lookout = Lookout(bug.looks)
        collision_points.prepare()
        sub_goals.prepare()
        self._moving = Moving.of([])
        self.seen = Traverse()  # T, SG and D
        self._open_points = np.empty((0, 10))
        self.collisions: list[Collision] = []
        self.leg: Leg | None = None
        self._route: list[int] = []  # places on the way back, the next one last
        self._wanted = -1  # the sub-goal that it goes back for
        self._blocking: list[tuple[Array, Array]] = []  # from where, and what was seen of it, a way turned out blocked
        self._looked_again = 0
        self._surprises = 0  # goal ways that turned out blocked since the last progress
        self._closest = math.inf
        self.decisions = 0
        self._news: list[str] = []

    # -- MAIN ----------------------------------------------------------------------------------------------------------

    def step(self, view: BugView) -> Move:
        """While not at the goal: detect obstacles; drive on, or look and decide."""
        if view.fresh:
            self.obstacles.update(view.panorama)
            self._moving = Moving.of(self.obstacles.dynamic)
        self.seen.pass_by(view.centre)
        seen = self._standing(view, view.panorama)
        if self.leg is not None and self._goes_on(self.leg, seen):
            return To(self.leg.target)
        if self.leg is not None:
            self._lookout.start()
            self.leg = None
        if not view.fresh:
            return Stand()
        panorama = self._lookout.look(view.panorama)
        if panorama is None and self._threat(seen) is None:
            return Stand()
        if panorama is not None:
            seen = self._standing(view, panorama)
        self.decisions += 1
        if self.decisions > self.parameters.max_iterations:
            return GiveUp(f"not there after {self.parameters.max_iterations} decisions", "stuck")
        return self._decide(seen)

    def _decide(self, view: BugView) -> Move:
        """Lines 6 to 29 of MAIN."""
        self.seen.arrive(view.centre)
        self._blocking = [(where, hits) for where, hits in self._blocking if math.dist(where, view.centre) < SAME]
        if self._blocking:  # other beams hit what those of this look pass
            view = replace(view, hits=np.concatenate([view.hits, *(hits for _, hits in self._blocking)]))
        self.seen.surfaces.remember(view.hits)
        if view.goal_distance < self._closest - SAME:
            self._closest, self._surprises = view.goal_distance, 0
        self.collisions = []
        if self._goal_way_is_free(view) and self._is_safe(view, view.goal.position, LegKind.GOAL):
            self._wanted, self._route = -1, []
            return self._go(Leg(LegKind.GOAL, view.goal.position))
        critical = self._goal_as_critical_point(view) or self._critical_point(view)
        if critical is not None:
            return self._go(critical)
        if self._threat(view) is not None:
            return self._evade(view)
        if self.collisions:
            self._news.append("waits for a moving obstacle")
            return Stand()
        if self._looked_again < _LOOKS_AGAIN:
            # It may be noise that keeps it from what it could reach: it looks again before it gives this place up.
            self._blocking, self._looked_again = [], self._looked_again + 1
            return Stand()
        back = self._back(view)
        if back is not None:
            return self._go(back)
        if self.seen.anything_open or len(self._moving):
            return Stand()
        return GiveUp("every sub-goal that is safe has been visited, and none led to the goal", "stuck")

    def _go(self, leg: Leg) -> Move:
        self.leg, self._looked_again = leg, 0
        self._news.append(leg.kind.value)
        return To(leg.target)

    # -- open points and sub-goals -------------------------------------------------------------------------------------

    def _critical_point(self, view: BugView) -> Leg | None:
        """The safe sub-goal in sight that is nearest to the goal and has not been visited (lines 7 to 18)."""
        if self._wanted >= 0:
            return self._towards_wanted(view)
        panorama = (
            with_virtual(view.panorama, self.collisions, self.parameters.collision_margin) if self.collisions else view.panorama
        )
        p = view.parameters
        self._open_points = rows = open_point_rows(panorama, p.range_jump, p.range_std)
        virtual = near_virtual(rows, self.collisions, self.parameters.collision_margin + 0.1)
        threatened = bool(virtual.any()) and self._threat(view) is not None
        for candidate in self.seen.candidates(view, rows, virtual, threatened, p.gap_tolerance):
            if self._is_safe(view, candidate.way, LegKind.CRITICAL):
                return Leg(LegKind.CRITICAL, candidate.way, candidate.subgoal)
        return None

    def _goal_as_critical_point(self, view: BugView) -> Leg | None:
        """The goal as a sub-goal like others, nearer to itself than any: what keeps the virtual circle from it may let pass the
        outline, or may be a corner to go round."""
        way = self.seen.way_to(view, view.goal.position, view.parameters.gap_tolerance)
        if way is None or self._surprises >= _TRIES or not self._is_safe(view, way, LegKind.CRITICAL):
            return None
        return Leg(LegKind.CRITICAL, way)

    @property
    def open_points(self) -> list[OpenPoint]:
        """OP of the last decision."""
        return points_of(self._open_points)

    # -- T and the way back --------------------------------------------------------------------------------------------

    def _back(self, view: BugView) -> Leg | None:
        """Back to the place from where the best sub-goal of D was seen, over points that it has been to."""
        self.seen.give_up_here()
        best = self.seen.best_left(view.centre, True)
        if best < 0:
            best = self.seen.best_left(view.centre, False)
        if best < 0:
            return None
        self._wanted, self._route, self._surprises = best, self.seen.way(self.seen.place_of(best)), 0
        return self._towards_wanted(view)

    def _towards_wanted(self, view: BugView) -> Leg | None:
        """The next leg of the way back; at its end the sub-goal itself."""
        for k, place in enumerate(self._route):  # the farthest place on the way that can be driven to at once
            point = self.seen.places[place].point
            if math.dist(point, view.centre) < SAME or (k < len(self._route) - 1 and self._fits(view, point, 1.0)):
                self._route = self._route[: k + 1]
                break
        if self._route and math.dist(self.seen.places[self._route[-1]].point, view.centre) < SAME:
            self._route.pop()
        if self._route:
            kind, way = LegKind.BACK, self.seen.places[self._route[-1]].point
        else:
            kind, way = LegKind.CRITICAL, self.seen.way_to(view, self.seen.target(self._wanted), 0.0)
        if way is not None and self._surprises < _TRIES:
            return Leg(kind, way, self._wanted) if self._is_safe(view, way, kind) else None
        self.seen.close(self._wanted)
        self._wanted, self._route, self._surprises = -1, [], 0
        return self._critical_point(view)

    # -- SAFE_POINT ----------------------------------------------------------------------------------------------------

    def _goal_way_is_free(self, view: BugView) -> bool:
        """Line 6: no obstacle in the direction of the goal, and no gap on the way there that is too narrow."""
        return (
            view.goal_in_sight()
            and self._surprises < _TRIES
            and not self._narrow(view, view.goal.position, 1.0 + view.parameters.gap_tolerance)
        )

    def _fits(self, view: BugView, target: Array, share: float) -> bool:
        """Whether the robot can drive straight to `target`, stand there, and passes only gaps wider than 2 r times `share`."""
        return view.reachable(target) and not self._narrow(view, target, share)

    def _narrow(self, view: BugView, target: Array, share: float) -> bool:
        """Whether the way passes a gap that is not wider than 2 r times `share`."""
        (x, y), width = view.centre, 2.0 * view.circle.radius * share
        dx, dy = target[0] - x, target[1] - y
        gap = narrow_gap(view.hits, x, y, math.atan2(dy, dx), math.hypot(dx, dy), width, view.circle.body)
        return math.isfinite(gap)

    def _is_safe(self, view: BugView, target: Array, kind: LegKind, turning: bool = True) -> bool:
        """Whether no moving obstacle meets the robot on its way to `target`; what does is kept as a virtual obstacle."""
        collision = self._predicted(view, target, turning, 0.0 if kind is LegKind.GOAL else _PAUSE)
        if collision is not None and all(c.obstacle.number != collision.obstacle.number for c in self.collisions):
            self.collisions.append(collision)
        return collision is None

    def _predicted(
        self, view: BugView, target: Array, turning: bool, stay: float, margin: float | None = None
    ) -> Collision | None:
        if not len(self._moving):
            return None
        p = view.parameters
        heading = view.heading_to(target)
        turn = abs(wrap_angle(heading - view.pose.theta)) / p.rotate_to_heading_angular_vel if turning else 0.0
        delay = turn + _TURN_DELAY if turning else 0.0
        radius = view.circle.body + (self.parameters.collision_margin if margin is None else margin)
        (x, y), length, speed = view.centre.tolist(), math.dist(view.centre, target), float(p.desired_linear_vel)
        drive = StraightDrive(x, y, heading, length, speed, delay, stay, radius)
        return predict(self._moving, view.time, drive, self.parameters.prediction_horizon + (stay if stay >= _STAY else 0.0))

    # -- on the way ----------------------------------------------------------------------------------------------------

    def _goes_on(self, leg: Leg, view: BugView) -> bool:
        """Whether a leg is neither finished nor blocked nor leads into a moving obstacle."""
        left = math.dist(view.centre, leg.target)
        if left <= ARRIVED:
            self._arrived(leg)
            return False
        if view.blocked and leg.kind is LegKind.EVADE:
            self._surprised(leg, "the guard has stopped it")
            return False
        if not view.fresh:
            return True
        if view.blocked:
            free = False
        elif leg.kind is LegKind.GOAL:
            free = view.goal_in_sight() and not self._narrow(view, leg.target, 1.0)
        elif leg.kind is LegKind.CRITICAL:
            slack = _SLACK * view.parameters.safety_constant
            free = view.reachable(leg.target, slack) and not self._narrow(view, leg.target, 1.0)
        else:  # where it has been already, or in a hurry: only what stops it counts
            free = True
        leg.flags = 0 if free else leg.flags + 1
        if leg.flags >= _FLAGS:
            self._blocking.append((view.centre, view.hits))
            self._surprised(leg, "the guard has stopped it" if view.blocked else "seen to be blocked")
            return False
        turning = abs(wrap_angle(view.heading_to(leg.target) - view.pose.theta)) > 0.5
        stay = _PAUSE if leg.kind is LegKind.CRITICAL else 0.0
        if leg.kind is not LegKind.EVADE and self._predicted(view, leg.target, turning, stay) is not None:
            self._news.append("a moving obstacle comes in the way")
            return False
        return True

    def _arrived(self, leg: Leg) -> None:
        self._surprises = 0
        if leg.subgoal >= 0 and leg.kind is LegKind.CRITICAL:
            if math.dist(leg.target, self.seen.target(leg.subgoal)) < SAME:  # not beside a corner on the way there
                self.seen.close(leg.subgoal)
            self._wanted = -1

    def _surprised(self, leg: Leg, why: str) -> None:
        """A way that was called free is not."""
        self._surprises += 1
        self._news.append(f"{leg.kind.value}: {why}")
        if leg.subgoal >= 0 and self._surprises >= _TRIES:
            self.seen.close(leg.subgoal)
            self._wanted, self._surprises = -1, 0

    # -- moving obstacles ----------------------------------------------------------------------------------------------

    def _standing(self, view: BugView, panorama: ScanPanorama) -> BugView:
        """What stands still, of this panorama."""
        if not len(self._moving) and panorama is view.panorama:
            return view
        still = standing_world(panorama, self._moving, 0.15)
        return replace(view, panorama=still, hits=still.hits())

    def _threat(self, view: BugView) -> Collision | None:
        """What would run into the robot if it stood still."""
        if not len(self._moving):
            return None
        margin = view.circle.body + 0.5 * self.parameters.collision_margin
        (x, y), horizon = view.centre.tolist(), 4.0
        waiting = StraightDrive(x, y, heading=0.0, length=0.0, speed=1.0, delay=0.0, stay=horizon, radius=margin)
        return predict(self._moving, view.time, waiting, horizon)

    def _evade(self, view: BugView) -> Move:
        """Out of the way: the shortest straight motion after which nothing comes, with less room where it is too late for more;
        else the one on which it comes latest."""
        threat = self._threat(view)
        best, latest = None, threat.first if threat is not None else math.inf
        angles = sorted(range(24), key=lambda k: abs(wrap_angle(k * math.pi / 12)))
        headings = [view.pose.theta + k * math.pi / 12 for k in angles]
        ends = [view.centre + length * np.array([math.cos(h), math.sin(h)]) for length in _EVADE for h in headings]
        reachable = [target for target in ends if view.reachable(target)]
        for share in (1.0, 0.6, 0.3):
            for target in reachable:
                collision = self._predicted(view, target, True, _STAY, share * self.parameters.collision_margin)
                if collision is None:
                    return self._go(Leg(LegKind.EVADE, target))
                if collision.first > latest + 0.3:
                    best, latest = target, collision.first
        return self._go(Leg(LegKind.EVADE, best)) if best is not None else Stand()

    # -- what is to be seen --------------------------------------------------------------------------------------------

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """Open points, sub-goals, critical point, virtual circle, d_min, obstacles that move, collisions, visited points."""
        ring = _RING
        moving = self.obstacles.dynamic
        drawn: dict[str, Drawable] = {
            "virtual_circle": Lines((view.centre + view.circle.radius * ring,), color=(60, 140, 220)),
            "d_min": Lines((np.array([view.centre, view.goal.position]),), color=(220, 40, 40)),
            "obstacles": Lines(tuple(self.obstacles.outlines(ring)), color=(150, 150, 150)),
            "moving": Arrows(_array([o.position for o in moving]), _array([o.velocity for o in moving])),
            "collision": Points(_array([c.point for c in self.collisions]), color=(255, 0, 0), radius=0.04),
            "virtual_obstacle": Lines(
                tuple(end + c.obstacle.radius * ring for c in self.collisions for end in (c.start, c.end)), color=(255, 120, 0)
            ),
        }
        if self._news:
            critical = [self.leg.target] if self.leg is not None else []
            drawn |= {
                "open_points": Points(_array([p.position for p in self.open_points]), color=(230, 60, 60)),
                "subgoals": Points(_array([s.point for s in self.seen.subgoals if s.open]), color=(60, 180, 75)),
                "critical_point": Points(_array(critical), color=PLAN_COLOR, radius=0.04),
                "visited": Points(self.seen.points(), color=(120, 120, 120)),
                "ocpb": Text("; ".join(self._news)),
            }
            self._news = []
        return drawn


def _array(points: list[Array]) -> Array:
    return np.array(points).reshape(-1, 2)


@declares(avoids_movers=unseen)
def build(context: Context) -> Reactive:
    """The navigator for the context's robot."""
    strategy = OperativeCriticalPointBug(context.parameters_of(OcpbParameters), context.parameters_of(BugParameters))
    return build_bug(context, strategy)
