"""Monte Carlo localization: the thesis' particle filter (section 3.5, Fig. 2.12), which also finds itself when it is lost.

    move:      every particle by the odometry, with noise                       (thesis, eq. 2.43; `motion_models`)
    weigh:     by how well what is seen fits to where the particle stands       (`sensor_models`)
    recover:   where it fits worse than the sensor model expects, the robot is elsewhere: particles are drawn from what is seen
    resample:  by weight, and scatter a little                                  (eq. 2.42; `resampling`)
    estimate:  mean and covariance, the heading's on the circle                 (eq. 2.43; `estimates`)

Recovery is augmented Monte Carlo localization (Thrun, Burgard and Fox 2005, Table 8.3, after Gutmann and Fox 2002) on an
absolute scale. A short-term average of how well pictures are explained says how many particles to draw anew. It is compared
with what the sensor model itself expects (`sensor_models.Matches.explained`), and not with a long-term average: that one is
high after good readings, so that ordinary ones look bad, and sinks with a filter that is wrong. Particles are drawn from the
sighting (sensor resetting: Lenser and Veloso 2000): a ball at a known distance leaves a circle, and its bearing then gives the
heading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Array, Belief, Command, Context, Detection, Landmark, Observation, Scalar, Segments, Text
from robocar.core.compiling import warm_up
from robocar.core.trace import Drawable
from robocar.estimation.landmarks import estimates, resampling, sensor_models
from robocar.estimation.landmarks.area import Area
from robocar.estimation.landmarks.estimates import PoseEstimate
from robocar.estimation.landmarks.guesses import Guesses
from robocar.estimation.landmarks.senses import Senses
from robocar.estimation.landmarks.sensor_models import EXPECTED_MATCH, Atlas, Matches
from robocar.estimation.odometry import motion_models
from robocar.estimation.odometry.motion_models import MotionParameters, move

MODELS = tuple(EXPECTED_MATCH)
_SHRINK, _LEAST_BIAS = 0.99, 0.01  # of the biases when resampling
_MOST_NEW = 0.9  # share of the particles that one sighting may replace


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Names are Nav2's (AMCL) where it has one.

    Args:
        min_particles, max_particles: how many, between them as `pf_err` and `pf_z` ask for (KLD sampling); equal: always so many.
        pf_err, pf_z: bound on the Kullback-Leibler distance, and quantile of the normal distribution it is kept with.
        model: `bearing-range`, or the thesis' `ranges` (its simulation) and `headings` (its robot).
        bearing_std, range_std: added in squares to what a detection says of itself [rad], [share of the range]: errors of
            pictures in a row are alike, so they count less than their number.
        outlier: likelihood of a sighting that is none of the landmark's, against 1 for a perfect one.
        resample: `systematic`, `wheel` or `residual`; done where N_eff is below `resample_below` times the number of particles.
        scatter_xy, scatter_theta: after resampling [m], [rad] (thesis, eq. 2.42).
        recovery_alpha_fast: rate of the average of how well pictures are explained, per picture, 0 for no recovery.
        recovery_sigmas: particles are drawn anew where that average is this many of its standard deviations below what the
            sensor model expects.
        estimate: `group` for the largest group of particles, `mean` for all.
        group_radius, group_angle: how far a group reaches [m], [rad].
        initial_std_xy, initial_std_theta: of the start, if it is known [m], [rad].
    """

    min_particles: int = 2000
    max_particles: int = 5000
    pf_err: float = 0.05
    pf_z: float = 2.33
    model: str = "bearing-range"
    bearing_std: float = 0.02
    range_std: float = 0.025
    outlier: float = 0.05
    resample: str = "systematic"
    resample_below: float = 0.5
    scatter_xy: float = 0.012
    scatter_theta: float = 0.009
    recovery_alpha_fast: float = 0.1
    recovery_sigmas: float = 4.0
    estimate: str = "group"
    group_radius: float = 0.4
    group_angle: float = 0.5
    initial_std_xy: float = 0.02
    initial_std_theta: float = 0.03

    def __post_init__(self) -> None:
        if not 1 <= self.min_particles <= self.max_particles:
            given = f"{self.min_particles} and {self.max_particles}"
            raise ValueError(f"the numbers of particles must be 1 <= min_particles <= max_particles, not {given}")
        for name, valid in (("model", MODELS), ("resample", tuple(resampling.SCHEMES)), ("estimate", ("group", "mean"))):
            if getattr(self, name) not in valid:
                raise ValueError(f"{name} is one of {', '.join(valid)}, not {getattr(self, name)!r}")
        for name in ("pf_err", "pf_z", "group_radius", "group_angle", "recovery_sigmas"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be a finite number above 0, not {getattr(self, name)}")
        for name in ("bearing_std", "range_std", "scatter_xy", "scatter_theta", "initial_std_xy", "initial_std_theta"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"{name} must be a finite number from 0 on, not {getattr(self, name)}")
        for name in ("outlier", "resample_below", "recovery_alpha_fast"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie between 0 and 1, not {getattr(self, name)}")


class ParticleFilter:
    """Particles (n, 3) with weights (n,), sum 1, and the steps of the filter on them.

    Each also has its opinion on the biases of the odometry, (n, 2), see `motion_models`.

    Args:
        atlas: the landmarks by name.
        area: where particles are drawn anew.
        start: the robot's pose, or None: anywhere in the area.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        motion: MotionParameters,
        atlas: Atlas,
        area: Area,
        start: SE2 | None,
        rng: np.random.Generator,
    ) -> None:
        self.parameters, self._motion, self._atlas, self._rng = parameters, motion, atlas, rng
        self._guesses = Guesses(atlas, area, parameters.bearing_std, parameters.range_std)
        self._odometry = SE2()
        n = parameters.max_particles
        if start is None:
            self.particles = self._guesses.anywhere(n, rng)
        else:
            std = (parameters.initial_std_xy, parameters.initial_std_xy, parameters.initial_std_theta)
            self.particles = start.as_array() + rng.standard_normal((n, 3)) * std
        self.weights = np.full(n, 1.0 / n)
        self.biases = rng.standard_normal((n, 2))
        # One that does not know where it is is as one that was carried off just now.
        expected = EXPECTED_MATCH[parameters.model]
        self._explained = 0.0 if start is None else expected.mean
        self._least = expected.least(parameters.recovery_alpha_fast, parameters.recovery_sigmas)

    def predict(self, step: SE2, velocity: bool = False) -> None:
        """Moves all particles by a step of the odometry, robot_from_next_robot, by the velocity model or the odometry model."""
        self._odometry = self._odometry @ step
        move(self.particles, self.biases, step, velocity, self._motion, self._rng)

    def weigh(self, detections: Sequence[Detection]) -> bool:
        """Weighs the particles by what is seen; False where no particle explains it at all: the weights are equal then."""
        p = self.parameters
        self._guesses.see(self._odometry, detections)
        matches = self._matches(detections)
        if len(matches.first) == 1:
            return True
        mean = sensor_models.reweigh(self.weights, matches.likelihoods(p.outlier))
        was_lost = self.lost_share > 0.0
        # Once a picture and not once a sighting: a picture taken while the robot turns is wrong about all that it shows.
        self._explained += p.recovery_alpha_fast * (matches.explained(self.weights) - self._explained)
        # What fits better than expected is not believed longer when it stops to fit.
        self._explained = min(self._explained, EXPECTED_MATCH[p.model].mean)
        if not was_lost and self.lost_share > 0.0:
            self._explained = 0.0  # carried off is as not knowing the start: all of the pose is looked for, for some pictures
        return mean > 0.0

    def _matches(self, detections: Sequence[Detection]) -> Matches:
        p = self.parameters
        if p.model == "headings":
            return sensor_models.headings(self.particles, [(d.landmark, d.bearing) for d in detections])
        model = sensor_models.ranges if p.model == "ranges" else sensor_models.bearing_range
        return model(self.particles, self._atlas.sightings(detections, p.bearing_std, p.range_std))

    @property
    def lost_share(self) -> float:
        """Share of the particles that should be drawn anew: max(0, 1 - average / least), least what chance explains."""
        return min(_MOST_NEW, max(0.0, 1.0 - self._explained / self._least)) if self._least > 0.0 else 0.0

    @property
    def effective_size(self) -> float:
        """N_eff"""
        return resampling.effective_size(self.weights)

    def resample(self, detections: Sequence[Detection] = ()) -> int:
        """New particles in place of light ones, where it is time; some drawn from `detections`, where the robot seems to be lost.

        Returns:
            How many were drawn anew.
        """
        p, rng = self.parameters, self._rng
        share = self.lost_share if detections else 0.0
        if share == 0.0 and self.effective_size >= p.resample_below * len(self.weights):
            return 0
        choose = resampling.SCHEMES[p.resample]
        count = p.max_particles
        if p.min_particles < p.max_particles and share == 0.0:
            bins = resampling.occupied_bins(self.particles, choose(self.weights, count, rng), 0.1, math.radians(10.0))
            count = min(max(math.ceil(resampling.kld_size(bins, p.pf_err, p.pf_z)), p.min_particles), p.max_particles)
        fresh = round(share * count)
        chosen = choose(self.weights, count - fresh, rng)
        kept = resampling.scattered(
            self.particles, self.weights, chosen, p.scatter_xy, p.scatter_theta, motion_models.bounded(rng, (len(chosen), 3))
        )
        self.particles = np.concatenate([kept, self._fresh(fresh, detections)]) if fresh else kept
        if fresh:  # who is lost still knows how the robot drives
            chosen = np.concatenate([chosen, chosen[rng.integers(len(chosen), size=fresh)]])
        self.biases = resampling.shrunk(self.biases, chosen, _SHRINK, _LEAST_BIAS, motion_models.bounded(rng, (count, 2)))
        self.weights = np.full(count, 1.0 / count)
        return fresh

    def _fresh(self, count: int, detections: Sequence[Detection]) -> Array:
        """Poses (count, 3) that what is seen suggests; anywhere, for headings alone."""
        if self.parameters.model == "bearing-range":
            return self._guesses.draw(count, self._odometry, detections, self._rng)
        if self.parameters.model == "ranges":
            return self._guesses.by_ranges(count, detections, self._rng)
        return self._guesses.anywhere(count, self._rng)

    def estimate(self) -> PoseEstimate:
        """Pose and covariance."""
        p = self.parameters
        if p.estimate == "mean":
            return estimates.mean_of_all(self.particles, self.weights)
        return estimates.largest_group(self.particles, self.weights, p.group_radius, p.group_angle)


class ParticleFilterEstimator:
    """`particle-filter`"""

    def __init__(self, context: Context) -> None:
        self._parameters = context.parameters_of(FilterParameters)
        self._motion = context.part("motion").parameters_of(MotionParameters)
        self._senses = Senses(context, "particle-filter")
        atlas, area = Atlas(context.landmarks), Area(context.prior, context.landmarks)
        self.filter = ParticleFilter(self._parameters, self._motion, atlas, area, context.start, context.rng)
        self._lost = context.start is None
        _warm_up()

    def update(self, observation: Observation, command: Command) -> Belief:
        sensed = self._senses.update(observation, command)
        self.filter.predict(sensed.step, self._motion.by_velocity(sensed.commanded))
        trace: dict[str, Drawable] = {**sensed.trace}
        if sensed.detections:
            if not self.filter.weigh(sensed.detections):
                trace["localization/state"] = Text("no particle explains what is seen; all weights are set equal", "WARN")
            trace["localization/n_eff"] = Scalar(self.filter.effective_size)
            self._say_whether_lost(trace)
            self.filter.resample(sensed.detections)
            trace["localization/particles"] = Scalar(len(self.filter.weights))
        estimate = self.filter.estimate()
        if sensed.detections:
            trace["sightings"] = sight_lines(estimate.pose, sensed.detections)
        weighted = np.concatenate([self.filter.particles, self.filter.weights[:, None]], axis=1)
        return Belief(estimate.pose, estimate.covariance, sensed.twist, weighted, trace, sensed.odom_from_robot)

    def _say_whether_lost(self, trace: dict[str, Drawable]) -> None:
        share = self.filter.lost_share
        trace["localization/lost"] = Scalar(share)
        if (share > 0.3) != self._lost and "localization/state" not in trace:
            self._lost = share > 0.3
            if self._lost:
                message = Text("what is seen does not fit: looking for the car everywhere", "WARN")
            else:
                message = Text("what is seen fits again")
            trace["localization/state"] = message


@warm_up
def _warm_up() -> None:
    """Every compiled step of every model."""
    rng, motion = np.random.default_rng(0), MotionParameters()
    ball = Landmark("red", "red", np.array([1.0, 0.0, 0.4]), 0.1)
    atlas, area = Atlas((ball,)), Area(None, (ball,))
    detection = Detection(0.0, "red", 0.0, 1.0, np.eye(2))
    for model in MODELS:
        trial = ParticleFilter(FilterParameters(model=model), motion, atlas, area, None, rng)
        for velocity in (True, False):
            trial.predict(SE2(0.1, 0.0, 0.1), velocity)
        trial.weigh([detection])
        trial.resample([detection])
        trial.estimate()
    weights = np.full(4, 0.25)
    for scheme in resampling.SCHEMES.values():
        scheme(weights, 2, rng)
    resampling.occupied_bins(np.zeros((4, 3)), np.arange(2), 0.1, 0.1)


def sight_lines(pose: SE2, detections: Sequence[Detection]) -> Segments:
    """Rays from the estimated pose to where the landmarks are seen, for the recording."""
    ends = [pose.apply(d.range * math.cos(d.bearing), d.range * math.sin(d.bearing)) for d in detections]
    return Segments(np.array([[(pose.x, pose.y), end] for end in ends]), color=(255, 200, 60))


def build(context: Context) -> ParticleFilterEstimator:
    """`particle-filter`"""
    return ParticleFilterEstimator(context)
