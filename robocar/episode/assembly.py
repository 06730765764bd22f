"""The parts of a run, or of a replay, put together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from robocar.core import SE2, Context, Estimator, Landmark, Navigator, OccupancyGrid, ParameterError, Robot, ScenarioError
from robocar.core.randomness import stream
from robocar.core.truth import GroundTruth
from robocar.episode.algorithms import Kind
from robocar.episode.given import Part, part_name
from robocar.episode.registry import build, capabilities
from robocar.episode.spec import RunSpec
from robocar.estimation.cascade import Cascade
from robocar.estimation.odometry.odometry import OdometryEstimator
from robocar.scenario.model import Scenario


def check_sight_of_movers(navigator: Part, scenario: Scenario, robot: Robot) -> None:
    """Whether a navigator that promises to keep off what moves is shown it, where something does.

    Raises:
        ParameterError: it is not; the message says what it needs.
    """
    avoids = capabilities("navigator", navigator).avoids_movers
    if scenario.movers and avoids is not None and (why := avoids(robot)):
        movers = f"{len(scenario.movers)} mover{'s' if len(scenario.movers) > 1 else ''}"
        raise ParameterError(f"navigator {part_name(navigator)!r} would not see the {movers} of {scenario.name!r} move: {why}")


@dataclass(frozen=True)
class Assembly:
    """What the parts are told, and the parts made from it.

    Args:
        robot: the machine.
        prior: the map that it is given, or None; start: the pose that it is told, or None.
        landmarks: that it is told of.
        control_period: [s].
        oracle: the simulator's truth, for the part that declares that it wants it; None without a simulator.
    """

    spec: RunSpec
    robot: Robot
    prior: OccupancyGrid | None
    start: SE2 | None
    landmarks: tuple[Landmark, ...]
    control_period: float
    oracle: Callable[[], GroundTruth] | None = None

    @property
    def explores(self) -> bool:
        """Whether the navigator draws a map instead of going to the scenario's goal.

        Raises:
            ParameterError: it does, and nothing draws a map.
        """
        explores = capabilities("navigator", self.spec.part("navigator")).explores
        if explores and self.spec.mapper == "none" and not capabilities("estimator", self.spec.part("estimator")).maps:
            raise ParameterError("a navigator that explores needs a map: --mapper laser or --mapper sonar")
        return explores

    @property
    def draws_map(self) -> bool:
        """Whether somebody draws a map."""
        return self.spec.mapper != "none" or capabilities("estimator", self.spec.part("estimator")).maps

    @property
    def knows_truth(self) -> bool:
        """Whether the estimator is the oracle, so that there is no localization to judge."""
        return capabilities("estimator", self.spec.part("estimator")).oracle

    def navigator(self) -> Navigator:
        """See `registry.build`.

        Raises:
            ParameterError: it promises to keep off what moves, something does, and the robot does not show it.
        """
        check_sight_of_movers(self.spec.part("navigator"), self.spec.scenario, self.robot)
        return self._part("navigator")

    def estimator(self) -> Estimator:
        """Pose estimator and mapper as one, or the estimator that is both.

        Raises:
            ScenarioError: an estimator that draws a map itself, with a mapper beside it; or the oracle without a simulator.
        """
        spec = self.spec
        declared = capabilities("estimator", spec.part("estimator"))
        if declared.maps and spec.mapper != "none":
            raise ScenarioError(f"estimator {spec.estimator!r} draws the map itself, and needs no mapper: --mapper none")
        if declared.oracle and self.oracle is None:
            raise ScenarioError(f"the pose oracle needs a simulator: a log cannot be replayed with --estimator {spec.estimator}")
        estimator = self._part("estimator", self.oracle if declared.oracle else None)
        if declared.maps:
            return estimator
        return Cascade(estimator, self._part("mapper"), capabilities("mapper", spec.part("mapper")).complete)

    def odometry(self) -> OdometryEstimator:
        """Dead reckoning beside the estimator, for metrics and pictures."""
        return OdometryEstimator(self._context("odometry"))

    def _part(self, kind: Kind, oracle: Callable[[], GroundTruth] | None = None) -> Any:
        given = dict(self.spec.parameters.get(kind, {}))
        context = replace(self._context(f"{kind}/{self.spec.parts[kind]}"), parameters=given, path=kind)
        return build(kind, self.spec.part(kind), context if oracle is None else replace(context, oracle=oracle))

    def _context(self, component: str) -> Context:
        rng = stream(self.spec.seed, component)
        return Context(self.robot, self.prior, self.start, self.landmarks, {}, rng, self.control_period)
