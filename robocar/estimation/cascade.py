"""An estimator made of two: one that says where the robot is, and one that draws a map from there."""

from __future__ import annotations

from robocar.core import Belief, Command, Context, Mapper, Observation, OccupancyGrid, PoseEstimator, State


class Cascade:
    """The pose first, and the map by it: no map corrects a pose, so it has one revision.

    Args:
        mapper: None: no map is drawn, and the state has none.
        complete: whether its grid shows every obstacle as it is now (`MapView.complete`).
    """

    def __init__(self, pose_estimator: PoseEstimator, mapper: Mapper | None = None, complete: bool = False) -> None:
        self.pose_estimator, self.mapper = pose_estimator, mapper
        self._view = None if mapper is None else MapperView(mapper, complete)

    def update(self, observation: Observation, command: Command) -> State:
        """Pose and map of this tick; `command` is the last one that was executed.

        Raises:
            TypeError: the pose estimator gives no belief.
        """
        belief = self.pose_estimator.update(observation, command)
        if not isinstance(belief, Belief):
            hint = (
                "; the factory of one that gives a state is declared: @declares(maps=True)" if isinstance(belief, State) else ""
            )
            raise TypeError(f"the estimator must return a belief, not {type(belief).__name__}{hint}")
        if self.mapper is not None:
            self.mapper.update(belief, observation)
        return State.of(belief, self._view)


class MapperView:
    """A mapper's map, as a `MapView`."""

    revision = 0

    def __init__(self, mapper: Mapper, complete: bool = False) -> None:
        self._mapper, self.complete = mapper, complete

    def grid(self) -> OccupancyGrid | None:
        """See `MapView.grid`."""
        return self._mapper.grid()


def no_mapper(context: Context) -> None:
    """`none`: draws no map."""
