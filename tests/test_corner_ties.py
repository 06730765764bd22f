"""A ray that runs exactly through a corner goes on along x first, whoever follows it: costmap, mapper, metric, ray casting."""

import math

import numpy as np
from numpy.typing import NDArray

from robocar.core.rays import first_hit, start_ray
from robocar.estimation.mapping.inverse_sensor import LaserModel, update_laser
from robocar.metrics.map import _see
from robocar.planners.costmap.obstacle_layer import mark_laser

SHAPE = (16, 16)
REACH = 6.0  # [cells]


def ties(n: int) -> list[tuple[float, float, float]]:
    """Poses (x, y, theta) whose ray meets the first corner exactly, in floating-point numbers too."""
    rng, found = np.random.default_rng(0), []
    while len(found) < n:
        theta, ahead = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 0.5)
        dx, dy = math.cos(theta), math.sin(theta)
        x, y = 8.0 - ahead * dx, 8.0 - ahead * dy  # the corner lies at (8, 8)
        ray = start_ray(x, y, dx, dy)
        if ray.next_x == ray.next_y:
            found.append((x, y, theta))
    return found


def by_costmap(x: float, y: float, theta: float) -> NDArray[np.bool_]:
    evidence, none = np.full(SHAPE, 4, dtype=np.int8), np.zeros(SHAPE, dtype=np.uint8)
    none_near, touched = np.zeros(SHAPE, dtype=np.bool_), np.empty(4, dtype=np.int64)
    mark_laser(evidence, none, none_near, touched, x, y, theta, np.array([math.inf]), np.zeros(1), REACH, REACH, 1.0)
    return evidence < 4


def by_mapper(x: float, y: float, theta: float) -> NDArray[np.bool_]:
    log_odds, stamp = np.zeros(SHAPE, dtype=np.float32), np.zeros(SHAPE, dtype=np.int32)
    model = LaserModel(max_range=REACH, hit_range=REACH, silent_range=REACH, hit=0.9, miss=-0.4)
    update_laser(log_odds, stamp, 1, x, y, theta, np.array([math.inf]), np.zeros(1), model, -5.0, 5.0)
    return log_odds < 0


def by_metric(x: float, y: float, theta: float) -> NDArray[np.bool_]:
    seen = np.zeros(SHAPE, dtype=np.bool_)
    _see(np.zeros(SHAPE, dtype=np.bool_), seen, np.array([[x, y, theta]]), REACH, 0.0, 1)
    return seen


def by_ray_casting(x: float, y: float, theta: float) -> NDArray[np.bool_]:
    seen = np.zeros(SHAPE, dtype=np.bool_)
    for cell in np.ndindex(SHAPE):
        blocked = np.zeros(SHAPE, dtype=np.bool_)
        blocked[cell] = True
        seen[cell] = first_hit(blocked, x, y, math.cos(theta), math.sin(theta), REACH) < math.inf
    return seen


def test_all_go_along_x_first() -> None:
    for x, y, theta in ties(40):
        row, col = math.floor(y), math.floor(x)
        beside, above = (row, 15 - col), (15 - row, col)  # the corner's other two cells
        for follow in (by_costmap, by_mapper, by_metric, by_ray_casting):
            passed = follow(x, y, theta)
            assert passed[row, col], follow
            assert passed[beside], follow
            assert not passed[above], follow
