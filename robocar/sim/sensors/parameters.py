"""The car's sensors: each with its own rate, delay, noise and random stream.

A sensor takes a reading when it is due and hands it out after its delay, so an observation may hold readings older than its own
time. Readings are due at multiples of the sensor's period and taken at the first control tick from then on.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from robocar.sim.sensors.accelerometer import AccelerometerParameters
from robocar.sim.sensors.bumper import BumperParameters
from robocar.sim.sensors.camera import CameraParameters, TopCameraParameters
from robocar.sim.sensors.compass import CompassParameters
from robocar.sim.sensors.encoder import EncoderParameters
from robocar.sim.sensors.lidar import LidarParameters
from robocar.sim.sensors.psd import PsdParameters
from robocar.sim.sensors.sonar import SonarParameters


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """One entry per kind of sensor, as in a scenario's `robot.sensors`."""

    encoder: EncoderParameters = field(default_factory=EncoderParameters)
    sonar: SonarParameters = field(default_factory=SonarParameters)
    lidar: LidarParameters = field(default_factory=LidarParameters)
    psd: PsdParameters = field(default_factory=PsdParameters)
    compass: CompassParameters = field(default_factory=CompassParameters)
    accelerometer: AccelerometerParameters = field(default_factory=AccelerometerParameters)
    bumper: BumperParameters = field(default_factory=BumperParameters)
    camera: CameraParameters = field(default_factory=CameraParameters)
    top_camera: TopCameraParameters = field(default_factory=TopCameraParameters)
