"""What the tests of whole runs share: a short scenario, the parts that drive it, and a reader of strict JSON."""

from __future__ import annotations

import json
from typing import Any

SHORT: dict[str, Any] = {
    "name": "short",
    "map": "maps/thesis_field.yaml",
    "start": [0.3, 0.3, 0],
    "goal": [1.2, 0.4],
    "time_limit": 30,
}
"""A few seconds of driving."""
PARTS = {"navigator": "a-star", "estimator": "odometry"}


def short(**changes: Any) -> dict[str, Any]:
    return SHORT | changes


def strict(text: str) -> Any:
    """JSON without Python's NaN and Infinity."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)
