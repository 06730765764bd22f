"""The algorithms that come with Robocar: their names, how they are built, and what can be set on them.

Adding one means writing its file and adding its line here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Kind = Literal["navigator", "estimator", "mapper"]


@dataclass(frozen=True, slots=True)
class Entry:
    """One algorithm that can be chosen by name.

    Args:
        factory: `module:function`, or the function, called with the `Context` and the factories in `parts`.
        parts: `module:function` of component factories (of a global planner and a controller, say).
        parameters: `module:Class` of the dataclasses whose fields may be set, by part: `""` is the algorithm itself
            (`--set navigator.<field>=value`), another one of its parts (`--set navigator.controller.<field>=value`).
        summary: one line for `robocar list`; paper: its source.
    """

    factory: str | Callable[..., Any]
    summary: str
    paper: str = ""
    parts: tuple[str, ...] = ()
    parameters: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


_AT = "robocar.planners."
_PURSUIT = (_AT + "controllers.pure_pursuit:PurePursuitParameters",)
_COSTMAP = _AT + "costmap.layered:CostmapParameters"
_OWN = _AT + "navigators.plan_and_follow:NavigatorParameters"


_Part = tuple[str, str]
"""A module of planners, and its dataclass of parameters."""
_A_STAR: _Part = ("search.a_star", "AStarParameters")
_THETA_STAR: _Part = ("search.theta_star", "ThetaStarParameters")
_RRT: _Part = ("sampling.rrt", "RrtParameters")
_DWA: _Part = ("controllers.dwa", "DwaParameters")
_MPPI: _Part = ("controllers.mppi", "MppiParameters")


def _follow(planner: _Part, summary: str, paper: str) -> Entry:
    """A navigator that plans on the map and follows the path by pure pursuit."""
    return Entry(
        _AT + "navigators.plan_and_follow:plan_and_follow",
        summary,
        paper,
        parts=(f"{_AT}{planner[0]}:build", _AT + "controllers.pure_pursuit:build"),
        parameters={"": (_OWN,), "planner": (_AT + ":".join(planner),), "controller": _PURSUIT, "costmap": (_COSTMAP,)},
    )


def _avoid(planner: _Part, controller: _Part, summary: str, paper: str) -> Entry:
    """A navigator that plans on the map, and whose controller looks for its own way along the path."""
    return Entry(
        _AT + "navigators.plan_and_follow:plan_and_avoid",
        summary,
        paper,
        parts=(f"{_AT}{planner[0]}:build", f"{_AT}{controller[0]}:build"),
        parameters={
            "": (_OWN,),
            "planner": (_AT + ":".join(planner),),
            "controller": (_AT + ":".join(controller), _AT + "controllers.steering:SteeringParameters"),
            "costmap": (_COSTMAP, _AT + "costmap.rolling:RollingCostmapParameters"),
            "recovery": (_AT + "navigators.recovery:RecoveryParameters",),
        },
    )


def _bug(module: str, summary: str, paper: str, *more: str) -> Entry:
    """A bug: what it sees all round, turns on the spot and straight motions."""
    return Entry(f"{_AT}{module}:build", summary, paper, parameters={"": (_AT + "bugs.view:BugParameters", *more)})


_BUGS = {
    "bug1": ("bugs.bug1", "once round every obstacle, left where it is closest to the goal", "Lumelsky and Stepanov 1987"),
    "bug2": ("bugs.bug2", "along obstacles back to the line from start to goal", "Lumelsky and Stepanov 1987"),
    "dist-bug": ("bugs.dist_bug", "along obstacles until what is free ahead brings it closer than ever", "Kamon and Rivlin 1997"),
    "tangent-bug": (
        "bugs.tangent_bug",
        "over ends of obstacles in sight that are closer to the goal",
        "Kamon, Rimon and Rivlin 1998",
    ),
    "point-bug": (
        "bugs.point_bug",
        "to the end of an obstacle whose direction is nearest to the goal's",
        "Buniyamin et al. 2011",
    ),
    "critical-point-bug": (
        "bugs.critical_point_bug",
        "to the unvisited end of an obstacle that is nearest to the goal, as a point",
        "Das, Dutta and Debnath, reference 22 of IJEECS 18(3), 2020",
    ),
}

NAVIGATORS: dict[str, Entry] = {
    "dynamic-a-star": Entry(
        _AT + "search.dynamic_a_star:build",
        "30 cm cells, replans when a sonar finds a cell blocked, looks around in each cell",
        "Utomo 2015, sections 2.6, 3.5, 4.3",
        parameters={"": (_AT + "search.dynamic_a_star_parameters:DynamicAStarParameters",)},
    ),
    "a-star": _follow(_A_STAR, "shortest grid path, followed by pure pursuit", "Hart, Nilsson and Raphael 1968"),
    "theta-star": _follow(_THETA_STAR, "any-angle path, followed by pure pursuit", "Daniel, Nash, Koenig and Felner 2010"),
    "d-star-lite": _follow(
        ("search.d_star_lite", "DStarLiteParameters"),
        "replans incrementally, followed by pure pursuit",
        "Koenig and Likhachev 2002",
    ),
    "harmonic": _follow(
        ("harmonic.planner", "HarmonicParameters"),
        "streamline of a harmonic potential, down the middle of the way, followed by pure pursuit",
        "Connolly, Burns and Weiss 1990; Saudi and Sulaiman",
    ),
    "harmonic-local": Entry(
        _AT + "harmonic.local:build",
        "down the gradient of a harmonic potential at each tick, with no path to keep to",
        "Connolly, Burns and Weiss 1990",
        parameters={
            "": (_OWN,),
            "planner": (_AT + "harmonic.planner:HarmonicParameters",),
            "controller": (_AT + "harmonic.local:HarmonicLocalParameters", *_PURSUIT),
            "costmap": (_COSTMAP,),
        },
    ),
    "rrt-dwa": _avoid(_RRT, _DWA, "random tree on the map; Dynamic Window Approach", "Izaty and Lubis, JITET"),
    "rrt-pursuit": _follow(_RRT, "random tree on the map, followed by pure pursuit", "Izaty and Lubis, JITET"),
    "a-star-dwa": _avoid(_A_STAR, _DWA, "shortest grid path; Dynamic Window Approach", "Fox, Burgard and Thrun 1997"),
    "a-star-mppi": _avoid(
        _A_STAR,
        _MPPI,
        "shortest grid path; model predictive path integral control",
        "Williams, Aldrich and Theodorou 2017",
    ),
    "theta-star-dwa": _avoid(_THETA_STAR, _DWA, "any-angle path; Dynamic Window Approach", "Fox, Burgard and Thrun 1997"),
    "ocpb": _bug(
        "bugs.ocpb.strategy",
        "critical points for a robot with dimension, among stationary and moving obstacles",
        "Das, Dutta and Debnath, IJEECS 18(3), 2020",
        _AT + "bugs.ocpb.strategy:OcpbParameters",
    ),
    **{name: _bug(*about) for name, about in _BUGS.items()},
    "safe-direction": Entry(
        _AT + "safe_direction.planner:build",
        "between the shortest and the safest direction of one scan; keeps to the middle, keeps no map",
        "Trihatmo, BPPT",
        parameters={"": (_AT + "safe_direction.method:SafeDirectionParameters",), "controller": _PURSUIT},
    ),
    "safe-direction-memory": Entry(
        _AT + "safe_direction.planner:build_with_memory",
        "the same with a memory of what was seen, on a grid that rolls along: gets out of deeper traps",
        "Trihatmo, BPPT",
        parameters={"": (_AT + "safe_direction.method:SafeDirectionParameters",), "controller": _PURSUIT},
    ),
    "path-transform": _follow(
        ("search.path_transform", "PathTransformParameters"),
        "cheapest path where nearness to obstacles costs, followed by pure pursuit",
        "Zelinsky 1994",
    ),
    "explore": Entry(
        _AT + "exploration.explore:build",
        "drives to frontiers until the map is complete; needs a mapper and ignores the goal",
        "Yamauchi 1997",
        parts=(_AT + "search.a_star:build", _AT + "controllers.pure_pursuit:build"),
        parameters={
            "": (_AT + "exploration.explore:ExploreParameters",),
            "planner": (_AT + "search.a_star:AStarParameters",),
            "controller": _PURSUIT,
        },
    ),
}

_LANDMARKS = {
    "motion": ("robocar.estimation.odometry.motion_models:MotionParameters",),
    "detector": ("robocar.estimation.landmarks.balls:BallParameters",),
    "odometry": ("robocar.estimation.odometry.odometry:OdometryParameters",),
}

ESTIMATORS: dict[str, Entry] = {
    "truth": Entry("robocar.sim.oracle:build", "the pose oracle: the simulator's own pose, for papers that assume it known"),
    "odometry": Entry(
        "robocar.estimation.odometry.odometry:build",
        "dead reckoning from the wheel encoders",
        "Utomo 2015, eq. 3.1-3.5",
        parameters={"": ("robocar.estimation.odometry.odometry:OdometryParameters",)},
    ),
    "odometry-compass": Entry(
        "robocar.estimation.odometry.odometry:build_with_compass",
        "dead reckoning, heading corrected by the compass",
        "Utomo 2015, section 5.2",
        parameters={"": ("robocar.estimation.odometry.odometry:OdometryParameters",)},
    ),
    "particle-filter": Entry(
        "robocar.estimation.landmarks.particle_filter:build",
        "Monte Carlo localization by the balls that the camera sees; finds itself when lost or carried off",
        "Utomo 2015, section 3.5; Thrun, Burgard and Fox 2005, Table 8.3",
        parameters={"": ("robocar.estimation.landmarks.particle_filter:FilterParameters",), **_LANDMARKS},
    ),
    "ekf": Entry(
        "robocar.estimation.landmarks.ekf:build",
        "extended Kalman filter by the balls that the camera sees",
        "Thrun, Burgard and Fox 2005, Table 7.2",
        parameters={"": ("robocar.estimation.landmarks.ekf:KalmanParameters",), **_LANDMARKS},
    ),
    "top-camera": Entry(
        "robocar.estimation.landmarks.top_camera:build",
        "the car's two markers, seen by the camera above the field; odometry in between",
        "Utomo 2015, section 3.5",
        parameters={
            "": ("robocar.estimation.landmarks.top_camera:TopCameraPoseParameters",),
            "odometry": ("robocar.estimation.odometry.odometry:OdometryParameters",),
        },
    ),
}

MAPPERS: dict[str, Entry] = {
    "none": Entry("robocar.estimation.cascade:no_mapper", "draws no map"),
    "laser": Entry(
        "robocar.estimation.mapping.mapping:build_laser",
        "occupancy grid from the laser, in log-odds",
        "Utomo 2015, sections 2.7, 4.5",
        parameters={"": ("robocar.estimation.mapping.mapping:MappingParameters",)},
    ),
    "sonar": Entry(
        "robocar.estimation.mapping.mapping:build_sonar",
        "occupancy grid from the sonars, in log-odds",
        "Utomo 2015, sections 2.7, 4.6",
        parameters={"": ("robocar.estimation.mapping.mapping:MappingParameters",)},
    ),
    "top-camera": Entry(
        "robocar.estimation.landmarks.top_camera:build_mapper",
        "obstacles on the floor that the camera above the field sees",
        "Utomo 2015, section 3.5",
        parameters={"": ("robocar.estimation.landmarks.top_camera:TopMapParameters",)},
    ),
}

TABLES: dict[Kind, dict[str, Entry]] = {"navigator": NAVIGATORS, "estimator": ESTIMATORS, "mapper": MAPPERS}
