"""The camera above the field (the thesis' global camera): where the car is, and where obstacles stand.

The car carries two coloured markers on its deck (models/robots/robocar/README.md). The camera's place and lens are known, so a
marker's pixel is a ray, and the ray meets the plane that the deck lies in.

Obstacles are what does not look like the floor. A camera sees them displaced outwards, the more the taller they are: what
stands on a spot hides the floor there *and* all points above it up to its own height. So a cell is occupied only where the
camera sees no floor on any of several heights above it (space carving from one view: Kutulakos and Seitz 2000);
`obstacle_height` says how high everything that matters is at least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robocar.core import (
    FREE,
    OCCUPIED,
    SE2,
    Array,
    Belief,
    Command,
    Context,
    Image,
    Observation,
    OccupancyGrid,
    Points,
    ScenarioError,
    declares,
)
from robocar.core.trace import Drawable
from robocar.estimation.landmarks.balls import HUES
from robocar.estimation.odometry.odometry import OdometryEstimator, OdometryParameters, propagate

FRONT, REAR = 0.045, -0.055  # [m] where the markers' middles are on the car's x axis
DECK, MARKER_RADIUS = 0.118, 0.030  # [m] height of the markers' tops
FRONT_COLOR, REAR_COLOR = "cyan", "magenta"

_MARKER_TOLERANCE = 0.03  # [m] of the distance between the markers
_MIN_SATURATION, _MIN_VALUE = 100, 25  # of 255
_WHOLE = 0.9  # of a marker's area: less, and something hides a part of it
_SUBCELLS = 3  # samples of a cell along each side
_FLOOR_CHROMA = (0.01, 0.16)  # (blue - red) / brightest channel of the floor's grey, which is cool; walls are warm
_FLOOR_LEVELS, _LEVEL_TOLERANCE = 2, 0.08  # its chequers: so many brightnesses, each within this share


@dataclass(frozen=True, slots=True)
class TopCameraPoseParameters:
    """
    Args:
        position_std, heading_std: of a pose from the markers [m], [rad].
    """

    position_std: float = 0.006
    heading_std: float = 0.012

    def __post_init__(self) -> None:
        for name in ("position_std", "heading_std"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be a finite number above 0, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class TopMapParameters:
    """
    Args:
        resolution: side of a cell where no prior map says it [m].
        obstacle_height: everything that is to be mapped is at least so high [m].
        car_radius: around the believed pose, what is no floor is the car [m].
    """

    resolution: float = 0.05
    obstacle_height: float = 0.15
    car_radius: float = 0.22

    def __post_init__(self) -> None:
        for name in ("resolution", "obstacle_height", "car_radius"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be a finite number above 0, not {getattr(self, name)}")


def find_car(image: Image) -> SE2 | None:
    """world_from_robot by the two markers; None where they are not both seen, or not as far apart as on the car."""
    best, off = None, _MARKER_TOLERANCE
    hsv = cv2.cvtColor(np.ascontiguousarray(image.pixels), cv2.COLOR_RGB2HSV_FULL)
    for front in _markers(image, hsv, FRONT_COLOR):
        for rear in _markers(image, hsv, REAR_COLOR):
            ahead = front - rear
            distance = math.hypot(*ahead)
            if abs(distance - (FRONT - REAR)) < off:
                off = abs(distance - (FRONT - REAR))
                x, y = 0.5 * (front + rear) - 0.5 * (FRONT + REAR) * ahead / distance
                best = SE2(float(x), float(y), math.atan2(ahead[1], ahead[0]))
    return best


def _markers(image: Image, hsv: NDArray, color: str) -> list[Array]:
    """Middles (2,) [m] of what may be a marker of this colour, on the deck's plane."""
    low, high = (degrees * 256.0 / 360.0 for degrees in HUES[color])
    mask = cv2.inRange(hsv, np.array([low, _MIN_SATURATION, _MIN_VALUE]), np.array([high, 255.0, 255.0]))
    count, labels, stats, middles = cv2.connectedComponentsWithStats(mask, connectivity=8)
    height = float(image.robot_from_camera[2, 3]) - DECK
    radius = MARKER_RADIUS * float(image.intrinsics[0, 0]) / height
    found = []
    for k in range(1, count):
        area = float(stats[k, cv2.CC_STAT_AREA])
        if not 0.2 < area / (math.pi * radius**2) < 2.5:
            continue
        middle = middles[k]
        if area < _WHOLE * math.pi * radius**2:  # the camera's head hides a part: the rest of the rim still shows the disc
            x, y, w, h = (int(n) for n in stats[k, :4])
            rows, cols = np.nonzero(labels[y : y + h, x : x + w] == k)
            middle = cv2.minEnclosingCircle(np.stack([cols + x, rows + y], axis=1).astype(np.float32))[0]
        found.append(floor_points(image, np.array(middle)[None] + 0.5, DECK)[0])
    return found


def floor_points(image: Image, pixels: Array, height: float) -> Array:
    """Where the rays through pixels (n, 2) meet the plane at `height` [m], (n, 2) [m] in the world."""
    world_from_camera = np.asarray(image.robot_from_camera)
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(image.intrinsics).T
    rays = rays @ world_from_camera[:3, :3].T
    origin = world_from_camera[:3, 3]
    return origin[:2] + rays[:, :2] * ((height - origin[2]) / rays[:, 2])[:, None]


def pixels_of(image: Image, points: Array, height: float) -> Array:
    """Inverse of `floor_points`: pixels (n, 2) of points (n, 2) [m] at `height` [m]."""
    world_from_camera = np.asarray(image.robot_from_camera)
    full = np.concatenate([points, np.full((len(points), 1), height)], axis=1) - world_from_camera[:3, 3]
    projected = full @ world_from_camera[:3, :3] @ image.intrinsics.T
    return projected[:, :2] / projected[:, 2:]


def floor_mask(pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (rows, cols) that look like the floor: a cool grey of two brightnesses, which are learnt from the picture itself."""
    values = pixels.astype(np.int16)
    brightest = values.max(axis=2)
    chroma = (values[..., 2] - values[..., 0]) / np.maximum(brightest, 1)
    grey = (chroma > _FLOOR_CHROMA[0]) & (chroma < _FLOOR_CHROMA[1]) & (brightest > 8)
    counts = np.bincount(brightest[grey], minlength=256).astype(float)
    floor = np.zeros(grey.shape, dtype=bool)
    for _ in range(_FLOOR_LEVELS):
        level = int(counts.argmax())
        if counts[level] < 0.02 * grey.size:
            break
        tolerance = max(2.0, _LEVEL_TOLERANCE * level)
        floor |= grey & (np.abs(brightest - level) <= tolerance)
        counts[max(0, level - 2 * round(tolerance)) : level + 2 * round(tolerance) + 1] = 0.0
    return floor


class TopCameraEstimator:
    """`top-camera`: the pose from the markers at each picture, by odometry in between."""

    def __init__(self, context: Context) -> None:
        _require_camera(context, "estimator")
        self._parameters = context.parameters_of(TopCameraPoseParameters)
        self._noise = OdometryParameters()
        self._odometry = OdometryEstimator(context.part("odometry"))
        self._reckoned: SE2 | None = None
        self._past: list[tuple[float, SE2]] = []
        self._pose = context.start or SE2()
        std = np.array([0.02, 0.02, 0.03]) if context.start is not None else np.array([10.0, 10.0, math.pi])
        self._covariance = np.diag(std**2)

    def update(self, observation: Observation, command: Command) -> Belief:
        belief = self._odometry.update(observation, command)
        if self._reckoned is not None and belief.pose != self._reckoned:
            step = self._reckoned.inverse() @ belief.pose
            self._covariance = propagate(self._covariance, self._pose, step, self._noise)
            self._pose = self._pose @ step
        self._reckoned = belief.pose
        self._past = [*self._past[-40:], (observation.time, belief.pose)]
        trace: dict[str, Drawable] = {}
        image = observation.top_image
        seen = find_car(image) if image is not None else None
        if image is not None and seen is not None:
            then = next((pose for time, pose in reversed(self._past) if time <= image.time + 1e-9), self._past[0][1])
            self._pose = seen @ (then.inverse() @ belief.pose)
            p = self._parameters
            self._covariance = np.diag([p.position_std**2, p.position_std**2, p.heading_std**2])
            spots = np.array([seen.apply(FRONT, 0.0), seen.apply(REAR, 0.0)])
            trace["markers"] = Points(spots, color=(0, 220, 220), radius=MARKER_RADIUS)
        return Belief(self._pose, self._covariance, belief.twist, None, trace, belief.pose)


class TopCameraMapper:
    """`top-camera`: obstacles as an occupancy grid, anew from each picture; where the car stands, as before."""

    def __init__(self, context: Context) -> None:
        _require_camera(context, "mapper")
        self._parameters = context.parameters_of(TopMapParameters)
        self._place = context.prior
        self._grid: OccupancyGrid | None = None

    def update(self, belief: Belief, observation: Observation) -> None:
        image = observation.top_image
        if image is None:
            return
        place = self._grid or self._place or self._cover(image)
        centres = place.world_from_cell(np.argwhere(np.ones(place.shape, dtype=bool)))
        hidden = self._hidden(image, place)
        data = np.where(hidden, OCCUPIED, FREE).astype(np.int8)
        near = np.hypot(*(centres - belief.pose.position).T).reshape(place.shape) < self._parameters.car_radius
        data[near] = self._grid.data[near] if self._grid is not None else FREE
        if self._grid is None or not np.array_equal(data, self._grid.data):
            self._grid = OccupancyGrid(data, place.resolution, place.origin)

    def grid(self) -> OccupancyGrid | None:
        return self._grid

    def _cover(self, image: Image) -> OccupancyGrid:
        """An empty grid of all that the picture shows of the floor."""
        height, width = image.pixels.shape[:2]
        corners = floor_points(image, np.array([[0.0, 0], [width, 0], [width, height], [0, height]]), 0.0)
        low, size = corners.min(axis=0), np.ptp(corners, axis=0)
        cols, rows = (max(1, int(side / self._parameters.resolution)) for side in size)
        return OccupancyGrid(
            np.zeros((rows, cols), dtype=np.int8), self._parameters.resolution, SE2(float(low[0]), float(low[1]))
        )

    def _hidden(self, image: Image, place: OccupancyGrid) -> NDArray[np.bool_]:
        """Cells (rows, cols) where the camera sees no floor, on most of their area and on all heights."""
        floor = floor_mask(image.pixels)
        rows, cols = place.shape
        steps = (np.arange(_SUBCELLS) + 0.5) / _SUBCELLS * place.resolution
        x, y = np.meshgrid(
            (np.arange(cols)[:, None] * place.resolution + steps).ravel(),
            (np.arange(rows)[:, None] * place.resolution + steps).ravel(),
        )
        points = place.origin.transform(np.stack([x.ravel(), y.ravel()], axis=1))
        blocked = np.ones(len(points), dtype=bool)
        for height in np.linspace(0.0, self._parameters.obstacle_height, 4):
            pixel = np.floor(pixels_of(image, points, float(height))).astype(int)
            inside = (pixel >= 0).all(axis=1) & (pixel < image.pixels.shape[1::-1]).all(axis=1)
            pixel[~inside] = 0
            blocked &= ~(floor[pixel[:, 1], pixel[:, 0]] & inside)
        share = blocked.reshape(rows, _SUBCELLS, cols, _SUBCELLS).mean(axis=(1, 3))
        return share > 0.5


def _require_camera(context: Context, what: str) -> None:
    if not context.robot.top_camera:
        raise ScenarioError(f"{what} 'top-camera' needs the camera above the field; fit it: robot.top_camera=true")


def build(context: Context) -> TopCameraEstimator:
    """The estimator `top-camera`."""
    return TopCameraEstimator(context)


@declares(complete=True)
def build_mapper(context: Context) -> TopCameraMapper:
    """The mapper `top-camera`."""
    return TopCameraMapper(context)
