"""Controls that MPPI samples, as the car would follow them, and what they cost: the compiled part of `mppi`.

In grid coordinates, like `trajectory_costs`: lengths in cells, speeds in cells per second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.controllers.trajectory_costs import RobotBody, RolloutAim, outline_cost, path_distance, toward
from robocar.planners.tracking.moving_obstacles import STAY, depth_later, encounter, met

COLLISION = 100.0  # cost of a trajectory that collides, far above all others
_PATH_EVERY = 3  # steps between two looks at the path, and one at the end


@njit(cache=True)
def correlate(noise: Array, correlation: float) -> None:
    """White noise (n, steps, 2) to noise of the same variance with this correlation between neighbouring steps, in place."""
    share = math.sqrt(1.0 - correlation * correlation)
    for k in range(noise.shape[0]):
        for i in range(1, noise.shape[1]):
            for j in range(2):
                noise[k, i, j] = correlation * noise[k, i - 1, j] + share * noise[k, i, j]


class ControlLimits(NamedTuple):
    """Of the sampled controls: accelerations [cells/s^2, rad/s^2], the range of v and the highest omega [cells/s, rad/s], and the
    v below which 1 / v^2 grows no further [cells/s]."""

    acc_v: float
    acc_omega: float
    lowest_v: float
    highest_v: float
    highest_omega: float
    slow_v: float


class CostWeights(NamedTuple):
    """Of a cell's cost, of a cell of distance to the goal and from the path, of slowness, and gamma, of the noise."""

    cost: float
    goal: float
    path: float
    slowness: float
    gamma: float


class Sampling(NamedTuple):
    """What is sampled: controls of the last tick (steps, 2), standard normal noise (n, steps, 2), its deviations (2,), and the
    time of a step [s]."""

    mean: Array
    noise: Array
    scale: Array
    dt: float


@njit(cache=True)
def sample_costs(
    costs: NDArray, start: Array, limits: ControlLimits, sampling: Sampling, body: RobotBody, aim: RolloutAim,
    weights: CostWeights, movers: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Costs of sampled controls, and the controls as the car would follow them.

    Args:
        start: x, y, theta and the present v, omega, (5,) [cells, rad, s].
        movers: discs that move (`robocar.planners.tracking.moving_obstacles`), (m, 5).

    Returns:
        (n,), `COLLISION` and above where the outline touches something; (n, steps, 2).
    """
    mean, noise, scale, dt = sampling
    goal, (n, steps, _) = aim.goal, noise.shape
    totals, controls = np.empty(n), np.empty((n, steps, 2))
    dv, dw = limits.acc_v * dt, limits.acc_omega * dt
    whole = steps * dt + STAY
    close_now = encounter(movers, 0.0, start[0], start[1])[1]
    for k in range(n):
        x, y, theta, v, w = start[0], start[1], start[2], start[3], start[4]
        cost_sum, path_sum, slow_sum, noise_sum, moved = 0.0, 0.0, 0.0, 0.0, 0.0
        looks, nearest, hit, depth_sum, close = 0, math.inf, -1, 0.0, 0.0
        for i in range(steps):
            push_v, push_w = scale[0] * noise[k, i, 0], scale[1] * noise[k, i, 1]
            v = toward(v, min(max(mean[i, 0] + push_v, limits.lowest_v), limits.highest_v), dv)
            w = toward(w, min(max(mean[i, 1] + push_w, -limits.highest_omega), limits.highest_omega), dw)
            controls[k, i, 0], controls[k, i, 1] = v, w
            noise_sum += mean[i, 0] * push_v / (scale[0] * scale[0]) + mean[i, 1] * push_w / (scale[1] * scale[1])
            if hit >= 0:
                continue
            middle = theta + 0.5 * w * dt
            c, s = math.cos(middle), math.sin(middle)
            x, y, theta = x + v * dt * c, y + v * dt * s, theta + w * dt
            moved += abs(v * dt) + body.radius * abs(w * dt)
            check = moved > 0.5 or i == steps - 1
            if check:
                moved = 0.0
            cost = outline_cost(costs, x, y, theta, body.vertices, body.safe_cost if check else 256.0, body.walled)
            if cost == math.inf:
                hit = i
                continue
            if len(movers) > 0:
                depth, closeness = encounter(movers, (i + 1) * dt, x, y)
                depth_sum += depth * dt / whole
                close = max(close, closeness * (1.0 - 0.5 * i / steps) - close_now)
            cost_sum += min(cost, 252.0)
            slow_sum += (limits.slow_v / max(v, limits.slow_v)) ** 2
            ahead_x, ahead_y = x + aim.forward * c, y + aim.forward * s
            dx, dy = goal[0] - ahead_x, goal[1] - ahead_y
            nearest = min(nearest, dx * dx + dy * dy)
            if i % _PATH_EVERY == 0 or i == steps - 1:
                path_sum += path_distance(aim.path, ahead_x, ahead_y)
                looks += 1
        total = weights.cost * cost_sum / steps + weights.slowness * slow_sum / steps + weights.gamma * noise_sum
        if hit < 0:
            depth_sum += depth_later(movers, steps * dt, STAY, 2.0 * dt, x, y) * 2.0 * dt / whole
        total += met(depth_sum, close)
        if hit >= 0:
            # The earlier it collides, the worse; so that where all do, the mean still leads away.
            totals[k] = COLLISION * (2.0 - hit / steps) + total
        else:
            totals[k] = total + weights.goal * math.sqrt(nearest) + weights.path * path_sum / max(looks, 1)
    return totals, controls


@njit(cache=True)
def positions(start: Array, controls: Array, dt: float) -> Array:
    """Along each of the trajectories that the controls (n, steps, 2) lead to, (n, steps + 1, 2)."""
    points = np.empty((controls.shape[0], controls.shape[1] + 1, 2))
    for k in range(controls.shape[0]):
        x, y, theta = start[0], start[1], start[2]
        points[k, 0] = x, y
        for i in range(controls.shape[1]):
            v, w = controls[k, i]
            middle = theta + 0.5 * w * dt
            x, y, theta = x + v * dt * math.cos(middle), y + v * dt * math.sin(middle), theta + w * dt
            points[k, i + 1] = x, y
    return points
