"""Occupancy grid mapping with known or estimated poses: the mappers `laser` and `sonar`.

The map's posterior factors into independent cells, each a binary Bayes filter in log-odds form (thesis, section 2.7; Thrun,
Burgard and Fox, Probabilistic Robotics, 2005, Table 9.1). What a reading says about a cell is in
`robocar.estimation.mapping.inverse_sensor`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Array, Belief, Context, Observation, OccupancyGrid, ParameterError, Scan
from robocar.core.compiling import warm_up
from robocar.estimation.mapping import inverse_sensor as model
from robocar.estimation.mapping.log_odds_grid import LogOddsGrid

_OCCUPIED = 0.65
"""`OccupancyGrid.occupied` begins here; free ends at its complement, so that evidence has the same weight either way."""
_ARC = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""Five directions of a cone, in halves of its opening angle."""


@dataclass(frozen=True, slots=True)
class MappingParameters:
    """Probabilities have the names and, for the laser, the values of Hornung et al., OctoMap (2013), section 4.3.

    Args:
        resolution: side of a cell [m].
        prob_hit: that the cell at the end of a beam is occupied; prob_miss: the same for a cell that it passes.
        clamping_thres_min, clamping_thres_max: probabilities beyond which a cell cannot grow surer: so it can change its mind.
        laser_hit_range: beams that end farther away mark nothing; laser_silent_range: one without return is free up to here [m].
        sonar_prob_hit: shared by the cells of an arc; sonar_prob_miss: of a cell on the cone's axis near the sensor.
        sonar_hit_range: echoes from farther away mark nothing; sonar_free_range: nor do they clear what lies beyond this [m].
        sonar_silent_range, sonar_prob_silent: a cone without echo counts as free up to here [m], with this probability near the
            sensor.
    """

    resolution: float = 0.05
    prob_hit: float = 0.7
    prob_miss: float = 0.35
    clamping_thres_min: float = 0.02
    clamping_thres_max: float = 0.98
    laser_hit_range: float = 30.0
    laser_silent_range: float = 6.0
    sonar_prob_hit: float = 0.8
    sonar_prob_miss: float = 0.35
    sonar_hit_range: float = 3.5
    sonar_free_range: float = 1.5
    sonar_silent_range: float = 1.0
    sonar_prob_silent: float = 0.45

    def __post_init__(self) -> None:
        for name in ("resolution", *(name for name in self.__dataclass_fields__ if name.endswith("_range"))):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be a positive number of metres, not {getattr(self, name)}")
        for name in ("prob_hit", "sonar_prob_hit", "clamping_thres_max"):
            if not 0.5 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} must lie between 0.5 and 1, not {getattr(self, name)}")
        for name in ("prob_miss", "sonar_prob_miss", "sonar_prob_silent", "clamping_thres_min"):
            if not 0.0 < getattr(self, name) < 0.5:
                raise ValueError(f"{name} must lie between 0 and 0.5, not {getattr(self, name)}")


def log_odds(probability: float) -> float:
    """log p / (1 - p)"""
    return math.log(probability / (1.0 - probability))


class OccupancyMapper:
    """Draws an occupancy grid from lasers, sonars or both, at the pose that the robot believes to have.

    The map begins around the first reading and grows. What it holds is asked for by `grid`: the probability in percent, unknown
    (-1) where nothing was seen or where it lies between 35 and 65 %.

    Args:
        lasers, sonars: which scans it takes in.
        footprint_radius: of a disc around the robot's origin that is free because the robot stands there [m].
    """

    def __init__(
        self, lasers: bool, sonars: bool, footprint_radius: float = 0.0, parameters: MappingParameters | None = None
    ) -> None:
        self.parameters = parameters or MappingParameters()
        self._lasers, self._sonars, self._radius = lasers, sonars, footprint_radius
        p = self.parameters
        self._bounds = log_odds(p.clamping_thres_min), log_odds(p.clamping_thres_max)
        self._laser_weights = log_odds(p.prob_hit), log_odds(p.prob_miss)
        weights = (p.sonar_prob_hit, p.sonar_prob_miss, p.sonar_prob_silent, _OCCUPIED)
        self._sonar_weights = tuple(log_odds(probability) for probability in weights)
        self._grid = LogOddsGrid(p.resolution, log_odds(_OCCUPIED) - 1e-6)
        self._stood: SE2 | None = None
        _warm_up()

    def update(self, belief: Belief, observation: Observation) -> None:
        """Takes in the scans of this tick.

        Raises:
            MapTooLarge: the pose lies so far away that the map would not fit into memory.
        """
        taken = False
        for scan in observation.scans:
            if scan.beam_width > 0.0 and self._sonars:
                self._take_sonar(belief.pose @ scan.robot_from_sensor, scan)
                taken = True
            elif scan.beam_width == 0.0 and self._lasers:
                self._take_laser(belief.pose @ scan.robot_from_sensor, scan)
                taken = True
        if taken and self._radius > 0.0:
            self._stand(belief.pose)

    def grid(self) -> OccupancyGrid | None:
        """The map as it is now, the same object until it changes; None before the first reading."""
        return self._grid.snapshot()

    @property
    def nbytes(self) -> int:
        """Memory of the cells [B]."""
        return self._grid.nbytes

    def _take_laser(self, world_from_sensor: SE2, scan: Scan) -> None:
        p, size = self.parameters, self.parameters.resolution
        ranges, bearings = np.array(scan.ranges), np.array(scan.bearings)  # writable: one compiled version for all
        silent = min(p.laser_silent_range, scan.max_range)
        reach = np.where(ranges == math.inf, silent, np.minimum(ranges, p.laser_hit_range) + size)
        used = np.isfinite(bearings) & (((ranges >= 0.0) & (ranges <= scan.max_range)) | (ranges == math.inf))
        if not self._touch(world_from_sensor, reach[used], bearings[used]):
            return
        grid = self._grid
        laser = model.LaserModel(scan.max_range / size, p.laser_hit_range / size, silent / size, *self._laser_weights)
        model.update_laser(
            grid.log_odds, grid.stamp, grid.next_mark(), *grid.local(world_from_sensor), ranges / size, bearings, laser,
            *self._bounds,
        )  # fmt: skip

    def _take_sonar(self, world_from_sensor: SE2, scan: Scan) -> None:
        p, size = self.parameters, self.parameters.resolution
        half = 0.5 * scan.beam_width
        for reading, bearing in zip(scan.ranges.tolist(), scan.bearings.tolist(), strict=True):
            if not (math.isfinite(bearing) and (0.0 <= reading <= scan.max_range or reading == math.inf)):
                continue
            free = min(p.sonar_silent_range if reading == math.inf else p.sonar_free_range, scan.max_range)
            reach = reading if reading <= p.sonar_hit_range else min(reading, free)
            # The arc bulges beyond the chords of these five points by less than a percent of its radius.
            self._touch(world_from_sensor, 1.01 * reach + size, bearing + half * _ARC)
            grid = self._grid
            x, y, theta = grid.local(world_from_sensor)
            sonar = model.SonarModel(half, p.sonar_hit_range / size, free / size, *self._sonar_weights)
            model.update_sonar(
                grid.log_odds, grid.stamp, grid.next_mark(), x, y, theta + bearing, reading / size, sonar, *self._bounds
            )

    def _touch(self, world_from_sensor: SE2, reach: Array | float, bearings: Array) -> bool:
        """Makes room for rays (n,) [m, rad] from the sensor; whether there are any."""
        if not len(bearings):
            return False
        angles = world_from_sensor.theta + bearings
        x, y = world_from_sensor.x + reach * np.cos(angles), world_from_sensor.y + reach * np.sin(angles)
        self._grid.touch(
            min(x.min(), world_from_sensor.x),
            min(y.min(), world_from_sensor.y),
            max(x.max(), world_from_sensor.x),
            max(y.max(), world_from_sensor.y),
        )
        return True

    def _stand(self, pose: SE2) -> None:
        """Clears the place of the robot, once for each half cell that it moves."""
        size, r = self.parameters.resolution, self._radius
        if self._stood is not None and self._stood.distance_to(pose) < 0.5 * size:
            return
        self._stood = pose
        self._grid.touch(pose.x - r, pose.y - r, pose.x + r, pose.y + r)
        x, y, _ = self._grid.local(pose)
        model.update_disc(self._grid.log_odds, x, y, r / size, self._laser_weights[1], *self._bounds)


@warm_up
def _warm_up() -> None:
    mapper = OccupancyMapper(True, True, 0.1)
    size = mapper.parameters.resolution
    ranges = np.array([2.0 * size, math.nan])
    laser, sonar = (Scan(0.0, ranges, np.zeros(2), 4.0 * size, beam_width) for beam_width in (0.0, 0.2))
    mapper.update(Belief(SE2()), Observation(0.0, lidar=laser, sonars=(sonar,)))
    mapper.grid()


def build_laser(context: Context) -> OccupancyMapper:
    """`laser`: from the laser alone.

    Raises:
        ParameterError: the robot carries none.
    """
    if context.robot.lidar is None:
        raise ParameterError("mapper 'laser' needs a laser: --set robot.lidar=hokuyo or scan360")
    return OccupancyMapper(True, False, context.robot.footprint.inscribed_radius, context.parameters_of(MappingParameters))


def build_sonar(context: Context) -> OccupancyMapper:
    """`sonar`: from the sonars alone.

    Raises:
        ParameterError: the robot carries none.
    """
    if not context.robot.sonars:
        raise ParameterError("mapper 'sonar' needs sonars: --set robot.sonars=front, front+sides or ring")
    return OccupancyMapper(False, True, context.robot.footprint.inscribed_radius, context.parameters_of(MappingParameters))
