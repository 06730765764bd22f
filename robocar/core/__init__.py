"""The values and interfaces that everything speaks. Imports numpy and numba, nothing else."""

from robocar.core.command import STOP, Command, Done, Drive, GiveUp, Hold, Serial
from robocar.core.errors import (
    BudgetExhausted,
    GoalOccupied,
    LogFormatError,
    MapFormatError,
    NoPathFound,
    OutputError,
    OutsideMap,
    ParameterError,
    PlanningError,
    RobocarError,
    ScenarioError,
    StartOccupied,
    UnknownNameError,
)
from robocar.core.footprint import Footprint
from robocar.core.geometry import SE2, Array, Twist, frozen_array, wrap_angle, wrap_angles
from robocar.core.grid import (
    FREE,
    INSCRIBED,
    LETHAL,
    NO_INFORMATION,
    OCCUPIED,
    UNKNOWN,
    Costmap,
    GridMap,
    OccupancyGrid,
)
from robocar.core.interfaces import Estimator, GlobalPlanner, LocalPlanner, Mapper, Navigator
from robocar.core.observation import Detection, Image, Observation, Reading, Scan, WheelAngles
from robocar.core.plan import Belief, Goal, Path, Plan
from robocar.core.robot import Calibration, Context, Landmark, Limits, RangeSensor, Robot
from robocar.core.trace import Arrows, Field, Lines, Points, Scalar, Segments, Text, Trace

__all__ = [name for name in globals() if not name.startswith("_")]
