"""Coloured balls in a camera's picture: which colour, in which direction, how far away.

A ball of radius r whose centre is at distance d from the camera fills a cone of rays with half angle alpha, sin(alpha) = r / d.
So every step works on rays, not on pixels, and off the picture's middle, where the ball's image is an ellipse, nothing needs to
be corrected:

1. pixels are classed by hue where they are colourful (HSV), and connected ones of one class form a region;
2. each region's rim is fitted by a cone (`cones.fit`): parts of the rim that lie on the picture's border are left out, parts that
   are covered by something else are outliers;
3. a ball seen whole is measured again by all of its pixels: the cone's axis is their mean ray, weighted by solid angle, and
   their solid angle together is 2 pi (1 - cos alpha);
4. what is no disc, or would float or sink if it were a ball of the known radius, is no ball.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robocar.core import Array, Detection, Image, Landmark
from robocar.core.compiling import warm_up
from robocar.estimation.landmarks import cones

HUES: dict[str, tuple[float, float]] = {
    "red": (-25.0, 14.0),
    "orange": (14.0, 49.0),
    "yellow": (49.0, 75.0),
    "green": (75.0, 160.0),
    "cyan": (160.0, 200.0),
    "blue": (200.0, 265.0),
    "magenta": (285.0, 335.0),
}
"""Hues of a colour's pixels [deg]. Wide, as lamps change them: in bright light orange saturates and nears yellow."""

_COLORS = tuple(HUES)
_MIN_SATURATION, _MIN_VALUE = 110, 25  # of 255; a world's greys have a saturation below 60
_MIN_PIXELS = 9
_TOLERANCE = 0.8  # [px] between the rim and a fitted cone: a rim without anti-aliasing is off by up to 0.5
_RIM_STD = 0.29  # [px] of such a rim: uniform in +-0.5
_CUT_STD = 1.4  # [px] of the rim of a ball that is not seen whole: some of it may be the rim of what covers it
_MIN_ARC = 1.0 / 3.0  # of a ball's rim that must be seen
_MIN_CUT_RADIUS = 4.0  # [px] smaller balls must be seen whole: a few pixels of a rim fit many circles
_MAX_RIM = 1.25
_MOST_RANGE_STD = 0.15  # of the range: an arc that says less may be no ball's
_FILL = (0.75, 1.3)  # what share of a whole ball's disc its pixels fill
_MIN_EXPLAINED = 0.93  # of a region's pixels that its balls must cover


@dataclass(frozen=True, slots=True)
class BallParameters:
    """
    Args:
        bearing_std: what the direction of a ball is off by, however large it looks (the car rolls and pitches) [rad].
        range_std: what its range is off by, as a share of it, however large it looks.
        height_tolerance, elevation_tolerance: a ball farther above or below where it should be is none [m], [rad].
    """

    bearing_std: float = 0.002
    range_std: float = 0.006
    height_tolerance: float = 0.08
    elevation_tolerance: float = 0.04


@dataclass(frozen=True, slots=True, eq=False)
class Ball:
    """A ball in a picture.

    Args:
        color: one of `HUES`.
        axis: unit vector to its centre in the camera's frame, (3,); half_angle: of its cone of rays [rad].
        whole: whether all of it is seen.
        covariance: of (axis sideways, axis upwards, half angle) at the camera, (3, 3) [rad^2].
        pixel: its centre in the picture, (2,) [px]; radius: there [px].
    """

    color: str
    axis: Array
    half_angle: float
    whole: bool
    covariance: Array
    pixel: Array
    radius: float


def _hue_classes() -> NDArray[np.uint8]:
    """Class of each of OpenCV's 256 hues: 1 + index into `HUES`, 0 for none."""
    table = np.zeros(256, dtype=np.uint8)
    degrees = np.arange(256) * (360.0 / 256.0)
    for code, (low, high) in enumerate(HUES.values(), start=1):
        table[((degrees - low) % 360.0) < (high - low)] = code
    return table


class BallDetector:
    """Finds balls of the known landmarks' colours.

    Landmarks of one colour share one radius and height (the mean of theirs): the picture does not say which is which.
    """

    def __init__(self, landmarks: Sequence[Landmark], parameters: BallParameters | None = None) -> None:
        """
        Args:
            landmarks: their colours, radii and heights; those of a colour that is not in `HUES` are not looked for.
        """
        self._parameters = parameters or BallParameters()
        self._known = {}
        for color in sorted({mark.color for mark in landmarks} & HUES.keys()):
            group = [mark for mark in landmarks if mark.color == color]
            heights = [float(mark.position[2]) for mark in group]
            self._known[color] = (float(np.mean([mark.radius for mark in group])), min(heights), max(heights))
        self._classes = _hue_classes()
        self._rays = _Rays()
        _warm_up()

    def detect(self, image: Image) -> tuple[Detection, ...]:
        """Bearing and range in the robot's frame of every ball in the picture; a detection's `landmark` is its colour.

        The range is that on the floor, from the robot's origin to the point below the ball.
        """
        return tuple(detection for _, detection in self.identify(image))

    def identify(self, image: Image) -> list[tuple[Ball, Detection]]:
        """The balls that `detect` finds, each with its detection."""
        robot_from_camera = np.asarray(image.robot_from_camera)
        located = ((ball, self._locate(ball, robot_from_camera, image.time)) for ball in self.find(image))
        return [(ball, detection) for ball, detection in located if detection is not None]

    def find(self, image: Image) -> list[Ball]:
        """Balls in the camera's own frame, wherever they are; sorted by colour, the largest first."""
        hsv = cv2.cvtColor(np.ascontiguousarray(image.pixels), cv2.COLOR_RGB2HSV_FULL)
        hue, saturation, value = cv2.split(hsv)
        classes = cv2.LUT(hue, self._classes)
        classes[(saturation < _MIN_SATURATION) | (value < _MIN_VALUE)] = 0
        counts = np.bincount(classes.ravel(), minlength=len(_COLORS) + 1)
        self._rays.see(image)
        balls: list[Ball] = []
        for color in self._known:
            code = 1 + _COLORS.index(color)
            if counts[code] < _MIN_PIXELS:
                continue
            mask = (classes == code).astype(np.uint8)
            count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
            regions = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] >= _MIN_PIXELS]
            for k in sorted(regions, key=lambda k: -stats[k, cv2.CC_STAT_AREA]):
                x, y, width, height = (int(n) for n in stats[k, :4])
                region = labels[y : y + height, x : x + width] == k
                balls += _balls_in(color, region, x, y, self._rays)
        return balls

    def _locate(self, ball: Ball, robot_from_camera: Array, time: float) -> Detection | None:
        """A ball of the known radius in the robot's frame; None where it would not lie where its landmarks do."""
        radius, lowest, highest = self._known[ball.color]
        distance = radius / math.sin(ball.half_angle)
        x, y, z = robot_from_camera[:3, :3] @ (distance * ball.axis) + robot_from_camera[:3, 3]
        ground = math.hypot(x, y)
        p = self._parameters
        slack = p.height_tolerance + p.elevation_tolerance * ground
        if not lowest - slack <= z <= highest + slack or ground < radius or _relative_range_std(ball) > _MOST_RANGE_STD:
            return None
        sideways = math.sqrt(ball.covariance[0, 0]) * distance / ground
        bearing_std = math.hypot(p.bearing_std, sideways)
        range_std = ground * math.hypot(p.range_std, _relative_range_std(ball))
        return Detection(time, ball.color, math.atan2(y, x), ground, np.diag([bearing_std**2, range_std**2]))


def _relative_range_std(ball: Ball) -> float:
    """d = r / sin(alpha): a relative error of the angle is one of the range."""
    return math.sqrt(ball.covariance[2, 2]) / ball.half_angle


class _Rays:
    """Unit vectors through the pixels of a picture and the solid angles that they fill; kept for pictures of the same size."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()

    def see(self, image: Image) -> None:
        key = (image.pixels.shape, np.asarray(image.intrinsics).tobytes())
        if key == self._key:
            return
        self._key = key
        height, width = image.pixels.shape[:2]
        k = np.asarray(image.intrinsics, dtype=float)
        self.focal = 0.5 * (k[0, 0] + k[1, 1])
        self.scale, self.centre = np.array([k[0, 0], k[1, 1]]), k[:2, 2]
        self.size = width, height
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        self.units = self.through(u, v)  # (height, width, 3)
        # A pixel covers dA cos^3 / f^2 of the unit sphere.
        self.solid_angles = self.units[..., 2] ** 3 / (k[0, 0] * k[1, 1])

    def through(self, u: NDArray, v: NDArray) -> Array:
        """Unit vectors (..., 3) through the points (u, v) [px] of the picture."""
        x, y = (u - self.centre[0]) / self.scale[0], (v - self.centre[1]) / self.scale[1]
        return np.stack([x, y, np.ones_like(x)], axis=-1) / np.sqrt(x * x + y * y + 1.0)[..., None]


def _balls_in(color: str, region: NDArray[np.bool_], x: int, y: int, rays: _Rays) -> list[Ball]:
    """Balls whose discs make up a region; none where discs do not explain it. Two that overlap in the picture are told apart."""
    rim, cut = _rim(region, x, y, rays.size)
    # A region without bays and holes has as many edges of pixels as its bounding box.
    if len(rim) < 6 or len(rim) + cut > _MAX_RIM * 2 * sum(region.shape):
        return []
    units = rays.through(rim[:, 0], rim[:, 1])
    free = np.ones(len(rim), dtype=bool)
    rows, cols = np.nonzero(region)
    inside = rays.units[rows + y, cols + x]
    covered = np.zeros(len(inside), dtype=bool)
    balls: list[Ball] = []
    seen, angles, half_angle = 0.0, np.empty(0), 0.0
    while len(balls) < 2 and np.count_nonzero(~covered) > (1 - _MIN_EXPLAINED) * len(inside):
        left = units[free]
        if len(left) < 6:
            return []
        axis, half_angle, inliers = cones.fit(left, _TOLERANCE / rays.focal)
        if not 1.0 / rays.focal < half_angle < 1.0:
            return []
        angles = cones.around(axis, left[inliers])
        seen = cones.arc(angles)
        if seen < _MIN_ARC:
            return []
        covered |= inside @ axis >= math.cos(half_angle + _TOLERANCE / rays.focal)
        balls.append(_measured(color, axis, half_angle, angles, rays))
        free[np.flatnonzero(free)[inliers]] = False
    if len(balls) == 1 and cut == 0 and np.count_nonzero(free) <= 0.1 * len(rim) and seen > 0.9:
        weights = rays.solid_angles[rows + y, cols + x]
        total = float(weights.sum())
        if not _FILL[0] < total / (math.tau * (1.0 - math.cos(half_angle))) < _FILL[1]:
            return []
        axis = weights @ inside
        balls = [_measured(color, axis / np.linalg.norm(axis), math.acos(1.0 - total / math.tau), angles, rays, whole=True)]
    elif np.count_nonzero(free) > 0.5 * len(rim) or any(ball.radius < _MIN_CUT_RADIUS for ball in balls):
        return []
    explained = np.count_nonzero(covered) >= _MIN_EXPLAINED * len(inside)
    return balls if explained else []


def _rim(region: NDArray[np.bool_], x: int, y: int, size: tuple[int, int]) -> tuple[Array, int]:
    """Points (n, 2) [px] halfway between a region's pixels and their neighbours; and how many lie on the picture's border."""
    padded = np.pad(region, 1)
    sides = padded[1:-1, 1:] != padded[1:-1, :-1]
    ends = padded[1:, 1:-1] != padded[:-1, 1:-1]
    rows, cols = np.nonzero(sides)
    low, left = np.nonzero(ends)
    u = np.concatenate([cols + float(x), left + (x + 0.5)])
    v = np.concatenate([rows + (y + 0.5), low + float(y)])
    width, height = size
    cut = (u <= 0.0) | (u >= width) | (v <= 0.0) | (v >= height)
    return np.stack([u[~cut], v[~cut]], axis=1).astype(np.float64), int(np.count_nonzero(cut))


def _measured(color: str, axis: Array, half_angle: float, angles: Array, rays: _Rays, whole: bool = False) -> Ball:
    """The ball with its covariance; `angles` are those of its rim's rays around the axis, (n,)."""
    covariance = cones.covariance(angles, (_RIM_STD if whole else _CUT_STD) / rays.focal)
    pixel = rays.scale * axis[:2] / axis[2] + rays.centre
    return Ball(color, axis, half_angle, whole, covariance, pixel, rays.focal * math.tan(half_angle) / float(axis[2]) ** 1.5)


@warm_up
def _warm_up() -> None:
    angles = np.linspace(0.0, 6.0, 12)
    units = np.stack([0.1 * np.cos(angles), 0.1 * np.sin(angles), np.full(12, math.sqrt(0.99))], axis=1)
    axis, _, _ = cones.fit(units, 0.01)
    cones.covariance(cones.around(axis, units), 0.01)
    cones.arc(angles)
