"""What trajectories cost. Oracle: the terms of each trajectory by their definitions, with lists and numpy."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.controllers.trajectory_costs import NEVER, RobotBody, RolloutAim, RolloutHorizon, rollouts
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.tracking.moving_obstacles import NONE, STAY, depth_later, encounter


class Step(NamedTuple):
    """Where a step ends, what is driven and turned in it, and the heading half-way."""

    x: float
    y: float
    theta: float
    driven: float
    turned: float
    middle: float


def trajectory(start: Array, limits: Array, sample: Array, horizon: RolloutHorizon) -> list[Step]:
    """Towards the twist at the limits, from step `brake` on towards rest; each step straight along the heading half-way."""
    x, y, theta, *twist = start.tolist()
    steps = []
    for i in range(horizon.steps):
        target = sample if i < horizon.brake else np.zeros(2)
        twist = twist + np.clip(target - twist, -limits * horizon.dt, limits * horizon.dt)
        driven, turned = twist * horizon.dt
        middle = theta + 0.5 * turned
        x, y, theta = x + driven * math.cos(middle), y + driven * math.sin(middle), theta + turned
        steps.append(Step(x, y, theta, abs(driven), abs(turned), middle))
    return steps


def cost_at(costs: NDArray, x: float, y: float) -> int | None:
    row, col = math.floor(y), math.floor(x)
    return int(costs[row, col]) if 0 <= row < costs.shape[0] and 0 <= col < costs.shape[1] else None


def steps_before_contact(costs: NDArray, steps: list[Step], body: RobotBody) -> int:
    """How many steps end without a contact.

    The outline is looked at in the last step and whenever a corner may have moved by over half a cell since the last time; not
    where the cell under the centre costs less than `safe_cost`. Outside of the grid it is looked at in every step.
    """
    moved = 0.0
    for i, step in enumerate(steps):
        moved += step.driven + body.radius * step.turned
        due = moved > 0.5 or i == len(steps) - 1
        cost = cost_at(costs, step.x, step.y)
        if cost is None or (due and cost >= body.safe_cost):
            inside = cost is not None and cost >= 254
            if len(body.vertices) and (inside or not footprint_free(costs, step.x, step.y, step.theta, body.vertices)):
                return i
        if due:
            moved = 0.0
    return len(steps)


def distance_to_path(path: Array, point: Array) -> float:
    a, b = path[:-1], path[1:]
    share = np.clip(np.sum((point - a) * (b - a), axis=1) / np.maximum(np.sum((b - a) ** 2, axis=1), 1e-300), 0.0, 1.0)
    nearest = np.concatenate([path[:1], a + share[:, None] * (b - a)])
    return float(np.linalg.norm(nearest - point, axis=1).min())


def terms(
    costs: NDArray, start: Array, steps: list[Step], body: RobotBody, aim: RolloutAim, horizon: RolloutHorizon, movers: Array
) -> list[float]:
    """A row of `rollouts`."""
    n, whole = horizon.steps, horizon.steps * horizon.dt + horizon.stay
    driven = steps[: steps_before_contact(costs, steps, body)]
    collides = len(driven) < n
    ahead = [np.array([s.x + aim.forward * math.cos(s.middle), s.y + aim.forward * math.sin(s.middle)]) for s in driven]
    under = [cost_at(costs, s.x, s.y) or 0 for s in driven]
    off = 0.0
    if len(driven) >= horizon.soon:
        s = driven[horizon.soon - 1]
        off = abs(math.remainder(math.atan2(aim.goal[1] - s.y, aim.goal[0] - s.x) - s.theta, math.tau))
    met = [encounter(movers, (i + 1) * horizon.dt, s.x, s.y) for i, s in enumerate(driven)]
    depth = sum(depth for depth, _ in met) * horizon.dt
    if not collides:  # then it stands there
        depth += (
            depth_later(movers, n * horizon.dt, horizon.stay, 2.0 * horizon.dt, driven[-1].x, driven[-1].y) * 2.0 * horizon.dt
        )
    now = encounter(movers, 0.0, start[0], start[1])[1]
    closer = [close * (1.0 - 0.5 * i / n) - now for i, (_, close) in enumerate(met)]
    return [
        float(collides),
        sum(min(cost, 252) for cost in under) / n,
        min((math.dist(aim.goal, point) for point in ahead), default=math.inf),
        distance_to_path(aim.path, ahead[-1] if ahead else start[:2]),
        sum(s.driven for s in driven),
        sum(s.turned for s in driven),
        off,
        depth / whole,
        max([0.0, *closer]),
    ]


@pytest.mark.parametrize("with_movers", [False, True])
@pytest.mark.parametrize("corners", [0, 3, 4])
def test_trajectories_cost_what_their_definitions_say(with_movers: bool, corners: int) -> None:
    """Oracle: the definitions, trajectory by trajectory, among random cells of all costs, also over the edge of the map."""
    rng, contacts, count = np.random.default_rng(3), 0, 0
    for _ in range(60):
        costs = np.where(rng.random((40, 50)) < 0.02, rng.integers(253, 256, (40, 50)), rng.integers(0, 253, (40, 50)))
        costs = costs.astype(np.uint8)
        angles = np.sort(rng.uniform(0.0, math.tau, corners))
        vertices = 3.0 * np.column_stack([np.cos(angles), np.sin(angles)])
        body = RobotBody(vertices, 3.0, float(rng.choice([0.0, 100.0, 200.0])), False)
        start = np.array(
            [*rng.uniform(-2.0, 52.0, 2), *rng.uniform(-3.0, 3.0, 1), *rng.uniform(-3.0, 8.0, 1), *rng.uniform(-1.5, 1.5, 1)]
        )
        limits, samples = rng.uniform(1.0, 20.0, 2), np.column_stack([rng.uniform(-4.0, 8.0, 6), rng.uniform(-1.5, 1.5, 6)])
        steps = int(rng.integers(1, 25))
        stay = float(rng.choice([0.0, STAY]))
        horizon = RolloutHorizon(0.1, steps, int(rng.integers(1, steps + 1)), int(rng.choice([NEVER, 5])), stay)
        aim = RolloutAim(
            rng.uniform(0.0, 50.0, (int(rng.integers(1, 6)), 2)), rng.uniform(0.0, 50.0, 2), float(rng.uniform(0.0, 5.0))
        )
        movers = np.column_stack(
            [start[:2] + rng.uniform(-15.0, 15.0, (3, 2)), rng.uniform(-8.0, 8.0, (3, 2)), rng.uniform(2.0, 8.0, 3)]
        )
        movers = movers if with_movers else NONE
        found = rollouts(costs, start, limits, samples, body, aim, horizon, movers)
        expected = [
            terms(costs, start, trajectory(start, limits, sample, horizon), body, aim, horizon, movers) for sample in samples
        ]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
        contacts, count = contacts + int(found[:, 0].sum()), count + len(found)
    assert contacts == 0 if corners == 0 else 0.1 * count < contacts < 0.9 * count
