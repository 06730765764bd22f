"""How often something large may be written."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any


class Throttle:
    """Keeps the newest value of each name and says when it may be written.

    Two writings under one name are `min_interval` apart, or longer where the size would exceed `rate` on average. A value that
    comes too early waits, so that the newest is always written in the end; a value that is the very object written before is not
    written again.

    Args:
        min_interval: [s].
        rate: [B/s] for each name.
        size: of a value [B].
    """

    def __init__(self, min_interval: float, rate: float, size: Callable[[Any], int]) -> None:
        self._min_interval, self._rate, self._size = min_interval, rate, size
        self._last: dict[str, Any] = {}
        self._waiting: dict[str, Any] = {}
        self._next: dict[str, float] = {}

    def offer(self, name: str, value: Any) -> None:
        """A new value."""
        if self._last.get(name) is not value:
            self._last[name] = self._waiting[name] = value

    def due(self, time: float) -> list[tuple[str, Any]]:
        """Names and values to write at `time` [s]; infinity asks for all that still wait."""
        if not self._waiting:
            return []
        ready = [name for name in self._waiting if time >= self._next.get(name, -math.inf)]
        return [(name, self._take(name, time)) for name in ready]

    def _take(self, name: str, time: float) -> Any:
        value = self._waiting.pop(name)
        self._next[name] = time + max(self._min_interval, self._size(value) / self._rate)
        return value
