"""The names of navigators, estimators and mappers, and how to build them.

Adding one means writing its file and adding its line here. Packages of others register theirs in the entry-point group
`robocar.planners` (`name = "package.module:factory"`), and the command line also takes `package.module:factory` itself.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import ModuleType
from typing import Any, Literal

from robocar.core import Context, ParameterError, RobocarError, UnknownNameError
from robocar.core.suggestions import did_you_mean

Kind = Literal["navigator", "estimator", "mapper"]


@dataclass(frozen=True, slots=True)
class Entry:
    """One algorithm that can be chosen by name.

    Args:
        factory: `module:function`, called with the `Context` and the factories in `parts`.
        parts: `module:function` of component factories (of a global and a local planner, say).
        parameters: `module:Class` of the dataclasses whose fields may be set by `--set <kind>.<field>=value`.
        summary: one line for `robocar list`; paper: its source.
    """

    factory: str
    summary: str
    paper: str = ""
    parts: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()


_AT = "robocar.planners."
_FOLLOWING = (
    _AT + "controllers.pure_pursuit:PurePursuitParameters",
    _AT + "costmap.layered:CostmapParameters",
    _AT + "navigators.plan_and_follow:NavigatorParameters",
)


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
        parameters=(_AT + ":".join(planner), *_FOLLOWING),
    )


def _avoid(planner: _Part, controller: _Part, summary: str, paper: str) -> Entry:
    """A navigator that plans on the map, and whose local planner looks for its own way along the path."""
    return Entry(
        _AT + "navigators.plan_and_follow:plan_and_avoid",
        summary,
        paper,
        parts=(f"{_AT}{planner[0]}:build", f"{_AT}{controller[0]}:build"),
        parameters=(
            _AT + ":".join(planner),
            _AT + ":".join(controller),
            _AT + "controllers.steering:SteeringParameters",
            _AT + "costmap.layered:CostmapParameters",
            _AT + "costmap.rolling:RollingCostmapParameters",
            _AT + "navigators.plan_and_follow:NavigatorParameters",
            _AT + "navigators.recovery:RecoveryParameters",
        ),
    )


def _bug(module: str, summary: str, paper: str, *more: str) -> Entry:
    """A bug: what it sees all round, turns on the spot and straight motions."""
    return Entry(f"{_AT}{module}:build", summary, paper, parameters=(_AT + "bugs.view:BugParameters", *more))


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
        parameters=(_AT + "search.dynamic_a_star:DynamicAStarParameters",),
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
        parameters=(
            _AT + "harmonic.local:HarmonicLocalParameters",
            _AT + "harmonic.planner:HarmonicParameters",
            *_FOLLOWING,
        ),
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
        parameters=(
            _AT + "safe_direction.method:SafeDirectionParameters",
            _AT + "controllers.pure_pursuit:PurePursuitParameters",
        ),
    ),
    "safe-direction-memory": Entry(
        _AT + "safe_direction.planner:build_with_memory",
        "the same with a memory of what was seen, on a grid that rolls along: gets out of deeper traps",
        "Trihatmo, BPPT",
        parameters=(
            _AT + "safe_direction.method:SafeDirectionParameters",
            _AT + "controllers.pure_pursuit:PurePursuitParameters",
        ),
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
        parameters=(
            _AT + "exploration.explore:ExploreParameters",
            _AT + "search.a_star:AStarParameters",
            _AT + "controllers.pure_pursuit:PurePursuitParameters",
        ),
    ),
}

ESTIMATORS: dict[str, Entry] = {
    "truth": Entry("robocar.sim.oracle:build", "the pose oracle: the simulator's own pose, for papers that assume it known"),
    "odometry": Entry(
        "robocar.estimation.odometry.odometry:build",
        "dead reckoning from the wheel encoders",
        "Utomo 2015, eq. 3.1-3.5",
        parameters=("robocar.estimation.odometry.odometry:OdometryParameters",),
    ),
    "odometry-compass": Entry(
        "robocar.estimation.odometry.odometry:build_with_compass",
        "dead reckoning, heading corrected by the compass",
        "Utomo 2015, section 5.2",
        parameters=("robocar.estimation.odometry.odometry:OdometryParameters",),
    ),
    "particle-filter": Entry(
        "robocar.estimation.landmarks.particle_filter:build",
        "Monte Carlo localization by the balls that the camera sees; finds itself when lost or carried off",
        "Utomo 2015, section 3.5; Thrun, Burgard and Fox 2005, Table 8.3",
        parameters=(
            "robocar.estimation.landmarks.particle_filter:FilterParameters",
            "robocar.estimation.odometry.motion_models:MotionParameters",
            "robocar.estimation.landmarks.balls:BallParameters",
        ),
    ),
    "ekf": Entry(
        "robocar.estimation.landmarks.ekf:build",
        "extended Kalman filter by the balls that the camera sees",
        "Thrun, Burgard and Fox 2005, Table 7.2",
        parameters=(
            "robocar.estimation.landmarks.ekf:KalmanParameters",
            "robocar.estimation.odometry.motion_models:MotionParameters",
        ),
    ),
    "top-camera": Entry(
        "robocar.estimation.landmarks.top_camera:build",
        "the car's two markers, seen by the camera above the field; odometry in between",
        "Utomo 2015, section 3.5",
        parameters=("robocar.estimation.landmarks.top_camera:TopCameraPoseParameters",),
    ),
}

MAPPERS: dict[str, Entry] = {
    "none": Entry("robocar.estimation.mapping.no_mapper:build", "draws no map"),
    "laser": Entry(
        "robocar.estimation.mapping.mapping:build_laser",
        "occupancy grid from the laser, in log-odds",
        "Utomo 2015, sections 2.7, 4.5",
        parameters=("robocar.estimation.mapping.mapping:MappingParameters",),
    ),
    "sonar": Entry(
        "robocar.estimation.mapping.mapping:build_sonar",
        "occupancy grid from the sonars, in log-odds",
        "Utomo 2015, sections 2.7, 4.6",
        parameters=("robocar.estimation.mapping.mapping:MappingParameters",),
    ),
    "top-camera": Entry(
        "robocar.estimation.landmarks.top_camera:build_mapper",
        "obstacles on the floor that the camera above the field sees",
        "Utomo 2015, section 3.5",
        parameters=("robocar.estimation.landmarks.top_camera:TopMapParameters",),
    ),
}

_BY_PATH = "given as package.module:factory"
_TABLES: dict[Kind, dict[str, Entry]] = {"navigator": NAVIGATORS, "estimator": ESTIMATORS, "mapper": MAPPERS}


def names(kind: Kind) -> dict[str, Entry]:
    """Registered names of this kind, third-party navigators included."""
    table = dict(_TABLES[kind])
    if kind == "navigator":
        for point in importlib.metadata.entry_points(group="robocar.planners"):
            table.setdefault(point.name, Entry(point.value, f"from {point.dist.name if point.dist else 'elsewhere'}"))
    return table


def find(kind: Kind, name: str) -> Entry:
    """The entry of a registered name, or of `package.module:factory`.

    Raises:
        UnknownNameError: nothing is registered under this name; the message lists what is.
    """
    table = names(kind)
    if name in table:
        return table[name]
    if ":" in name:
        _load(name, f"{kind} {name!r}")
        return Entry(name, _BY_PATH)
    raise UnknownNameError(f"unknown {kind} {name!r}{did_you_mean(name, table)}; known: {', '.join(sorted(table))}")


def build(kind: Kind, name: str, context: Context) -> Any:
    """The algorithm `name` for this context.

    Raises:
        UnknownNameError: see `find`.
        ParameterError: the context's parameters hold a name that none of the algorithm's dataclasses has, or a bad value; or
            somebody else's factory failed.
    """
    entry = find(kind, name)
    known = parameters(entry)
    ours = name in _TABLES[kind]
    if known or ours:  # a third party's factory without a dataclass of parameters looks at them itself
        _refuse_unknown(kind, name, context.parameters, known)
    what = f"{kind} {name!r}"
    factory, parts = _load(entry.factory, what), [_load(part, what) for part in entry.parts]
    try:
        return factory(context, *parts)
    except RobocarError:
        raise
    except Exception as error:
        if ours:
            raise
        raise ParameterError(f"{what} cannot be built: {type(error).__name__}: {error}") from error


def parameters(entry: Entry) -> dict[str, Any]:
    """Names and defaults of everything that can be set on an algorithm."""
    found: dict[str, Any] = {}
    for path in entry.parameters:
        for field in fields(_load(path, path)):
            found[field.name] = field.default
    if not entry.parameters and ":" in entry.factory:
        # A factory by its path: its module's dataclass `Parameters`, or the one called after the module, if it has one.
        path = entry.factory.partition(":")[0]
        called_after = "".join(word.capitalize() for word in path.rpartition(".")[2].split("_")) + "Parameters"
        for name in ("Parameters", called_after):
            cls = getattr(_import(path, entry.factory), name, None)
            if isinstance(cls, type) and is_dataclass(cls):
                return {field.name: field.default for field in fields(cls)}
    return found


def _refuse_unknown(kind: Kind, name: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    for key in given:
        if key not in known:
            valid = ", ".join(sorted(known)) or "none"
            raise ParameterError(f"{kind} {name!r} has no parameter {key!r}{did_you_mean(key, known)}; it has: {valid}")


def _load(path: str, what: str) -> Any:
    module, _, attribute = path.partition(":")
    found = getattr(_import(module, what), attribute, None)
    if not callable(found):
        raise UnknownNameError(f"{what}: {module!r} has no function or class {attribute!r}")
    return found


def _import(module: str, what: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise UnknownNameError(f"{what}: there is no module {error.name!r}") from error
    except Exception as error:  # whatever the module does while it is imported
        raise UnknownNameError(f"{what}: {module!r} cannot be imported: {type(error).__name__}: {error}") from error
