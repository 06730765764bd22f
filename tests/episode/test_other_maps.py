"""Maps that nobody here drew. Oracles: scipy's labels and distances for start and goal, the shortest path, the true way."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robocar.episode.run import run
from robocar.formats import load_map


class TestOtherMaps:
    """Maps that nobody here drew, driven with the pose oracle."""

    @pytest.mark.parametrize(
        ("file", "resolution", "start", "goal"),
        [
            ("ros_maps/turtlebot3/map.yaml", 0.05, None, None),
            ("ros_maps/nav2/tb3_sandbox.yaml", 0.05, None, None),
            ("ros_maps/nav2/testmap.yaml", 0.5, None, None),
            ("movingai/room-32-32-4.map", 0.5, None, None),
            ("movingai/random-32-32-10.map", 0.6, None, None),
        ],
    )
    def test_is_driven(self, file: str, resolution: float, start: Any, goal: Any, data_dir: Path) -> None:
        """Start and goal: two of the roomiest free cells, some cells apart, connected by scipy's labels."""
        grid = load_map(data_dir / file, resolution)
        a, b = far_apart(grid, reach=2.5)
        content = {"name": "map", "map": str(data_dir / file), "resolution": resolution, "start": [*a, 0.0], "goal": list(b)}
        result = run(content | {"time_limit": 60}, navigator="a-star", estimator="truth")
        assert result.status == "success", result.reason
        assert result.value("contacts") == 0
        assert math.dist(result.truth.poses[-1, :2], b) <= 0.10
        shortest, length = result.value("shortest_path_length"), result.value("path_length")
        assert shortest is not None
        assert length is not None
        assert shortest - 0.11 <= length <= 1.5 * shortest + 0.3


def far_apart(grid: Any, reach: float) -> tuple[list[float], list[float]]:
    """Two centres of cells at most `reach` apart along x or y, each 0.25 m from all that is not free, with a way in between."""
    from scipy import ndimage

    closed = np.pad(~grid.free, 1, constant_values=True)
    room = ndimage.distance_transform_edt(~closed)[1:-1, 1:-1] * grid.resolution - 0.71 * grid.resolution
    labels, _ = ndimage.label(room > 0.22)
    cells = np.argwhere(room > 0.25)
    start = cells[len(cells) // 2]
    near = cells[labels[tuple(cells.T)] == labels[tuple(start)]]
    distances = np.hypot(*(near - start).T) * grid.resolution
    goal = near[np.argmax(np.where(distances <= reach, distances, -1.0))]
    assert 0.5 < np.hypot(*(goal - start)) * grid.resolution <= reach
    return grid.world_from_cell(start).tolist(), grid.world_from_cell(goal).tolist()
