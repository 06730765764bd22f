"""Model predictive path integral control: its noise, its costs, its weights, and how it drives."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Drive, Goal, Path, Twist
from robocar.planners.controllers import mppi
from robocar.planners.controllers.mppi import MPPI, MppiParameters
from robocar.planners.controllers.sampled_controls import ControlLimits, CostWeights, Sampling, correlate, sample_costs
from robocar.planners.controllers.trajectory_costs import RobotBody, RolloutAim
from robocar.planners.costmap.layered import CostmapParameters, inflate
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.navigators.plan_and_follow import plan_and_avoid
from robocar.planners.search import a_star
from robocar.planners.tracking.moving_obstacles import NONE
from tests.planners.controllers.test_dwa import OPEN, at
from tests.planners.kinematic import DT, car, context, drive
from tests.planners.navigators.test_plan_and_follow import field


def planner(seed: int = 0, **parameters: object) -> MPPI:
    chosen = MppiParameters(**parameters)  # type: ignore[arg-type]
    return MPPI(car(), DT, np.random.default_rng(seed), chosen, inflation=CostmapParameters())


@pytest.mark.parametrize("correlation", [0.0, 0.7, 0.95])
def test_noise_has_its_variance_and_correlation(correlation: float) -> None:
    """Analytic: an AR(1) process of variance 1, correlation rho^k at lag k; 40 000 samples, five standard errors."""
    noise = np.random.default_rng(0).standard_normal((40_000, 12, 2))
    correlate(noise, correlation)
    for lag in (0, 1, 4):
        found = np.mean(noise[:, 7, 0] * noise[:, 7 + lag, 0])
        assert found == pytest.approx(correlation**lag, abs=5 * math.sqrt(2.0 / 40_000))
    assert np.mean(noise[:, 7, 0] * noise[:, 7, 1]) == pytest.approx(0.0, abs=5 / math.sqrt(40_000))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_costs_are_those_of_the_trajectories(seed: int) -> None:
    """Oracle: written down naively, each pose checked; random controls among boxes, each as the car can follow it."""
    rng = np.random.default_rng(seed)
    grid = field(120, 120, (3.4, 2.4, 3.8, 2.8), (3.6, 3.5, 3.7, 4.4))
    robot = car()
    costs = inflate(grid, robot.footprint.inscribed_radius, CostmapParameters(walled=False)).data
    outline = np.array(robot.footprint.vertices / 0.05)
    start = np.array([60.0, 60.0, rng.uniform(-1, 1), 4.0, 0.5])
    limits = ControlLimits(16.0, 4.0, 0.0, 8.0, 1.5, 1.0)
    mean = np.column_stack([rng.uniform(0, 8, 12), rng.uniform(-1, 1, 12)])
    noise = rng.standard_normal((6, 12, 2))
    path, goal = np.array([[60.0, 60.0], [75.0, 66.0], [90.0, 60.0]]), np.array([85.0, 62.0])
    weights = CostWeights(0.01, 0.02, 0.03, 0.2, 0.002)
    scale = np.array([4.0, 0.8])
    sampling, body, aim = Sampling(mean, noise, scale, 0.1), RobotBody(outline, 2.9, 0.0, False), RolloutAim(path, goal, 3.0)
    found, controls = sample_costs(costs, start, limits, sampling, body, aim, weights, NONE)
    for k in range(6):
        x, y, theta, v, w = start
        total, near, off, free = 0.0, math.inf, [], True
        for i in range(12):
            wanted = mean[i] + scale * noise[k, i]
            v = np.clip(np.clip(wanted[0], 0.0, 8.0), v - 1.6, v + 1.6)
            w = np.clip(np.clip(wanted[1], -1.5, 1.5), w - 0.4, w + 0.4)
            np.testing.assert_allclose(controls[k, i], [v, w], atol=1e-12)
            c, s = math.cos(theta + 0.05 * w), math.sin(theta + 0.05 * w)
            x, y, theta = x + 0.1 * v * c, y + 0.1 * v * s, theta + 0.1 * w
            free &= footprint_free(costs, x, y, theta, outline)
            total += weights[0] * min(float(costs[math.floor(y), math.floor(x)]), 252.0) / 12
            total += weights[3] * (1.0 / max(v, 1.0)) ** 2 / 12 + weights[4] * float(np.sum(mean[i] * noise[k, i] / scale))
            ahead = np.array([x + 3.0 * c, y + 3.0 * s])
            near = min(near, math.dist(ahead, goal))
            if i % 3 == 0 or i == 11:
                points = np.concatenate([np.linspace(a, b, 2001) for a, b in itertools.pairwise(path)])
                off.append(np.linalg.norm(points - ahead, axis=1).min())
        total += weights[1] * near + weights[2] * float(np.mean(off))
        assert (found[k] < 50.0) == free
        assert found[k] == pytest.approx(total, abs=1e-3) or not free


def test_equal_seeds_give_equal_commands_and_others_do_not() -> None:
    path, goal = Path(np.array([[0.0, 0.0], [2.5, 0.0]])), Goal(np.array([2.5, 0.0]))
    runs = []
    for seed in (1, 1, 2):
        local, pose, twists = planner(seed), SE2(0.0, 0.1, 0.3), []
        for tick in range(40):
            command = at(pose, local, OPEN, path, goal, tick)
            assert isinstance(command, Drive)
            twists.append(command.twist)
            pose = pose @ command.twist.step(DT)
        runs.append(twists)
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_the_colder_the_nearer_to_the_best_sample() -> None:
    """Analytic: with a temperature near 0 the mean is the best of the samples, so it costs no more than any of them."""
    path, goal = Path(np.array([[0.0, 0.0], [2.5, 0.0]])), Goal(np.array([2.5, 0.0]))
    costs = []
    for temperature in (1e-6, 10.0):
        local = planner(3, temperature=temperature, batch_size=300, gamma=0.0)
        at(SE2(), local, OPEN, path, goal)
        costs.append(local._mean[:, 0].mean())
    # Before an open way all that matters is to get on: the best sample is faster than the mean of nearly all.
    assert costs[0] > costs[1] + 0.03


def test_it_arrives_and_keeps_speeds_and_accelerations() -> None:
    """Property: within the limits at each tick; it stands at the goal in the end."""
    limits, goal = car().limits, Goal(np.array([1.5, 0.5]), heading=2.0)
    path, pose, twists = Path(np.array([[0.0, 0.0], [1.0, 0.0], [1.5, 0.5]])), SE2(), []
    local = planner()
    for tick in range(400):
        command = at(pose, local, OPEN, path, goal, tick)
        assert isinstance(command, Drive)
        twists.append((command.twist.v, command.twist.omega))
        pose = pose @ command.twist.step(DT)
    assert goal.reached(pose)
    assert twists[-1] == (0.0, 0.0)
    assert 0.0 <= np.min(twists, axis=0)[0] <= np.max(twists, axis=0)[0] <= limits.max_vel_x
    assert np.abs(np.diff(twists, axis=0)).max(axis=0)[0] <= limits.acc_lim_x * DT + 1e-9
    assert np.abs(np.diff(twists, axis=0)).max(axis=0)[1] <= limits.acc_lim_theta * DT + 1e-9


def test_unknown_boxes_are_driven_around() -> None:
    """Two boxes that the prior does not show; contact is checked exactly at every tick."""
    world = field(60, 120, (2.0, 1.2, 2.4, 1.7), (3.7, 1.3, 4.0, 1.9))
    start, goal = SE2(0.5, 1.5, 2.0), Goal(np.array([5.4, 1.5]))
    navigator = plan_and_avoid(context(car(), field(60, 120), start, batch_size=400), a_star.build, mppi.build)
    result = drive(navigator, car(), world, start, goal)
    assert result.status == "success", result.reason


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("batch_size", 0), ("time_steps", -1), ("model_dt", 0.0), ("vx_std", 0.0), ("wz_std", math.nan), ("temperature", 0.0),
        ("noise_correlation", 1.0), ("noise_correlation", -0.1), ("gamma", -1.0), ("cost_weight", math.inf), ("lookahead", 0.0),
    ],
)  # fmt: skip
def test_wrong_parameters_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        MppiParameters(**{name: value})  # type: ignore[arg-type]


# -- what moves ----------------------------------------------------------------------------------------------------------


def test_a_twist_is_a_twist() -> None:
    """Commands hold plain numbers, which the recording needs."""
    command = at(SE2(), planner(), OPEN, None, Goal(np.array([2.0, 0.0])))
    assert isinstance(command, Drive)
    assert [type(number) for number in (command.twist.v, command.twist.omega)] == [float, float]
    assert command.twist != Twist()
