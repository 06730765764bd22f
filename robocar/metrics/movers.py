"""How near a run came to the obstacles that move: `movers/*` of `metrics.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from robocar.core import Array, Footprint
from robocar.core.distance import convex_distance
from robocar.metrics.declaration import metric
from robocar.metrics.run_log import Track

HORIZON = 10.0  # [s] collisions farther ahead are no matter: nobody keeps the present speed for so long
TOUCH = 1e-5  # [m] two outlines this near touch


@metric(
    "movers/min_time_to_collision", unit="s", needs=("footprint", "truth_poses", "truth_twists", "movers"), where="movers"
)  # a faster way may pass nearer: not judged
def min_time_to_collision(footprint: Footprint, poses: ArrayLike, twists: ArrayLike, movers: Mapping[str, Track]) -> float | None:
    """Smallest `time_to_collision` of all movers and ticks [s]; None where no collision was ahead."""
    return _smallest([time_to_collision(footprint, poses, twists, track) for track in movers.values()])


@metric("movers/closest_approach", unit="m", needs=("footprint", "truth_poses", "movers"), where="movers")
def closest_approach(footprint: Footprint, poses: ArrayLike, movers: Mapping[str, Track]) -> float | None:
    """Smallest distance from the footprint to a mover, of all movers and ticks [m]."""
    return _smallest([distance(footprint, poses, track) for track in movers.values()])


def time_to_collision(footprint: Footprint, poses: ArrayLike, twists: ArrayLike, mover: Track, horizon: float = HORIZON) -> Array:
    """Time until the car's footprint would touch the mover if both went on as at each tick.

    Hayward, Near-Miss Determination Through Use of a Scale of Danger (1972): the time until two road users collide if they stay
    on their courses at their speeds. The car goes on along the arc of its twist (v, omega), the mover straight on, turning at its
    rate. Found by conservative advancement (Mirtich, Impulse-based Dynamic Simulation, 1996): the distance d of two
    bodies cannot shrink faster than V = |v| + |omega| R + |v_m| + |omega_m| R_m, with R the radii around their origins, so it is
    safe to look again d / V later. Outlines within `TOUCH` touch.

    Args:
        poses, twists: of the car, (n, 3) and (n, 2).
        horizon: how far ahead is looked [s].

    Returns:
        (n,) [s]; 0 in contact, inf where they do not touch within `horizon`, nan where a number is not finite.
    """
    car = np.hstack([np.asarray(poses, dtype=float).reshape(-1, 3), np.asarray(twists, dtype=float).reshape(-1, 2)])
    return _times(_corners(footprint.vertices), car, _corners(mover.shape.outline), mover.shape.radius, _states(mover), horizon)


def distance(footprint: Footprint, poses: ArrayLike, mover: Track) -> Array:
    """From the footprint to the mover at each tick, (n,) [m]; 0 in contact, nan where a number is not finite."""
    car = np.asarray(poses, dtype=float).reshape(-1, 3)
    return _distances(_corners(footprint.vertices), car, _corners(mover.shape.outline), mover.shape.radius, _states(mover))


def _smallest(values: list[Array]) -> float | None:
    """Of all movers and ticks; None where there is no finite one."""
    together = np.concatenate(values) if values else np.empty(0)
    together = together[np.isfinite(together)]
    return float(together.min()) if together.size else None


def _states(mover: Track) -> Array:
    """Poses and velocities, (n, 6)."""
    return np.hstack([np.asarray(part, dtype=float).reshape(-1, 3) for part in (mover.poses, mover.velocities)])


def _corners(polygon: ArrayLike) -> Array:
    return np.array(polygon, dtype=float, order="C")  # writable: numba compiles anew for read-only arrays


@njit(cache=True)
def _place(corners: Array, x: float, y: float, theta: float, out: Array) -> None:
    """Corners of a frame at (x, y, theta)."""
    c, s = math.cos(theta), math.sin(theta)
    for i in range(len(corners)):
        out[i, 0] = x + c * corners[i, 0] - s * corners[i, 1]
        out[i, 1] = y + s * corners[i, 0] + c * corners[i, 1]


@njit(cache=True)
def _distances(feet: Array, car: Array, outline: Array, radius: float, mover: Array) -> Array:
    n = len(car)
    result = np.empty(n)
    a, b = np.empty(feet.shape), np.empty(outline.shape)
    for k in range(n):
        if not (np.isfinite(car[k].sum()) and np.isfinite(mover[k].sum())):
            result[k] = math.nan
            continue
        _place(feet, car[k, 0], car[k, 1], car[k, 2], a)
        _place(outline, mover[k, 0], mover[k, 1], mover[k, 2], b)
        result[k] = max(convex_distance(a, b) - radius, 0.0)
    return result


@njit(cache=True)
def _reach(corners: Array) -> float:
    """Radius around the origin."""
    farthest = 0.0
    for i in range(len(corners)):
        farthest = max(farthest, math.hypot(corners[i, 0], corners[i, 1]))
    return farthest


@njit(cache=True)
def _times(feet: Array, car: Array, outline: Array, radius: float, mover: Array, horizon: float) -> Array:
    n = len(car)
    result = np.full(n, math.inf)
    a, b = np.empty(feet.shape), np.empty(outline.shape)
    feet_reach, mover_reach = _reach(feet), _reach(outline)
    for k in range(n):
        if not (np.isfinite(car[k].sum()) and np.isfinite(mover[k].sum())):
            result[k] = math.nan
            continue
        x, y, theta, v, omega = car[k, 0], car[k, 1], car[k, 2], car[k, 3], car[k, 4]
        mx, my, turn, vx, vy, rate = mover[k, 0], mover[k, 1], mover[k, 2], mover[k, 3], mover[k, 4], mover[k, 5]
        fastest = abs(v) + abs(omega) * feet_reach + math.hypot(vx, vy) + abs(rate) * mover_reach
        if math.hypot(mx - x, my - y) - feet_reach - mover_reach - radius > max(fastest * horizon, TOUCH):
            continue
        time = 0.0
        # Each look but the last is at least TOUCH / fastest after the one before.
        for _ in range(2 + math.ceil(min(horizon * fastest / TOUCH, 1e7))):
            half = 0.5 * omega * time  # the chord of an arc of angle 2 half points half way between the headings
            chord = v * time * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
            _place(feet, x + chord * math.cos(theta + half), y + chord * math.sin(theta + half), theta + 2.0 * half, a)
            _place(outline, mx + vx * time, my + vy * time, turn + rate * time, b)
            gap = convex_distance(a, b) - radius
            if gap <= TOUCH:
                result[k] = time
                break
            if fastest == 0.0:
                break
            time += gap / fastest
            if time > horizon:
                break
    return result
