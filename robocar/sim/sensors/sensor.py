"""What a file of this folder says about its type of sensors.

To add a type: a file `<type>.py` in this folder that defines `SENSOR`, or in a package of one's own the entry point
`<type> = "package.module:SENSOR"` in the group `robocar.sensors`; and the sensor's entry in a robot's `robot.yaml`.

A sensor takes a reading when it is due and hands it out after its delay, so an observation may hold readings older than its own
time. Readings are due at multiples of the sensor's period and taken at the first control tick from then on.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from robocar.core import SE2, Array, RangeSensor
from robocar.sim.sensors.base_pose import BasePose


class Timed(Protocol):
    """What the parameters of every type hold."""

    @property
    def period(self) -> float:
        """Between two readings [s]; 0: one at every control tick."""
        ...

    @property
    def delay(self) -> float:
        """Until a reading arrives [s]."""
        ...


P = TypeVar("P", bound=Timed)


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Where a sensor sits on its robot, as `robot.yaml` says.

    Args:
        name: of the sensor, unique on its robot; its readings and its random stream carry it.
        label: its short name, e.g. of its scans.
        element: name in the MJCF of what it reads (a sensor, a camera), without the robot's prefix; may be empty.
        position: in the frame of the robot's base, (3,) [m].
        robot_from_sensor: the same on the floor plane, with the direction in which it looks.
    """

    name: str
    label: str
    element: str
    position: Array
    robot_from_sensor: SE2


@dataclass(frozen=True, slots=True, eq=False)
class Fitting:
    """A sensor's place in a compiled world: all that its readings can be made of.

    Args:
        mount: where it sits.
        model: of the world.
        data: of the world.
        prefix: of the robot's names in the model.
        rng: the sensor's own random stream.
        met_by_rays: geom groups that this robot's rays meet, (6,).
        shown: geom groups that a camera shows, (6,).
        base_pose: world_from_base of this instant.
        counts: whole pulses of the left and the right encoder since the start.
        pulse: angle of one pulse [rad].
        at_close: takes what is to be given back when the world is closed.
    """

    mount: Mount
    model: mujoco.MjModel
    data: mujoco.MjData
    prefix: str
    rng: np.random.Generator
    met_by_rays: NDArray[np.uint8]
    shown: NDArray[np.uint8]
    base_pose: Callable[[], BasePose]
    counts: Callable[[], tuple[int, int]]
    pulse: float
    at_close: ExitStack

    def sensor_data(self) -> Array:
        """MuJoCo's view of the numbers of the MJCF sensor that the mount names."""
        return self.data.sensor(self.prefix + self.mount.element).data


@dataclass(frozen=True, slots=True)
class SensorType(Generic[P]):
    """A type of sensors.

    Args:
        parameters: a frozen dataclass; every field has a default, a scenario's `robot.sensors.<type>` sets them.
        reader: what takes a reading at a time [s], made once for each sensor.
        geometry: what algorithms are told about it; for sensors that measure ranges.
        element: type of the MJCF sensor that it reads (`Fitting.sensor_data`), if it reads one.
        firmware_input: the one that its readings may be connected to, `compass` or `bumper`.
    """

    parameters: type[P]
    reader: Callable[[Fitting, P], Callable[[float], Any]]
    geometry: Callable[[Mount, P], RangeSensor] | None = None
    element: mujoco.mjtSensor | None = None
    firmware_input: Literal["compass", "bumper"] | None = None
