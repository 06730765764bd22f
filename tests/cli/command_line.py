"""What the tests of the command line share: where the project lies, a short scenario, and the type of a call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHORT = {"map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0], "goal": [1.2, 0.4], "time_limit": 30}
Call = Callable[..., tuple[int, str, str]]
