"""What the tests of the sensors share: sensors without noise, a hall, and a car that is put somewhere."""

from __future__ import annotations

from robocar.core import SE2, Hold, Observation
from robocar.sim.sensors.accelerometer import AccelerometerParameters
from robocar.sim.sensors.compass import CompassParameters
from robocar.sim.sensors.lidar import LidarParameters
from robocar.sim.sensors.parameters import SensorParameters
from robocar.sim.sensors.psd import PsdParameters
from robocar.sim.sensors.sonar import SonarParameters
from robocar.sim.simulation import Simulation

EXACT = SensorParameters(
    sonar=SonarParameters(range_std=0.0, relative_std=0.0, dropout=0.0),
    lidar=LidarParameters(range_std=0.0, dropout=0.0),
    psd=PsdParameters(relative_std=0.0),
    compass=CompassParameters(std=0.0, resolution=0.0),
    accelerometer=AccelerometerParameters(std=0.0),
)
TILT = 0.002  # [m] the car sinks and nods a little on its tyres
HALL = (24.0, 24.0)  # larger than any range in its middle


def observe(simulation: Simulation, pose: SE2) -> tuple[Observation, SE2]:
    """What the car senses a tick after it was put somewhere, and where it is then."""
    simulation.kidnap(pose)
    simulation.act(Hold())
    return simulation.sense(), simulation.ground_truth().pose
