"""Readings that are taken when they are due and arrive after a delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Channel(Generic[T]):
    """Takes readings when they are due and hands each out once, after its delay."""

    def __init__(self, period: float, delay: float, read: Callable[[float], T]) -> None:
        self._period = period
        self._delay = delay
        self._read = read
        self._taken = 0
        self._under_way: deque[tuple[float, T]] = deque()

    def poll(self, time: float) -> T | None:
        """The newest reading that has arrived by `time` [s] and was not handed out yet."""
        # A millionth of the step absorbs the rounding of sums of time steps.
        if time + 1e-9 >= self._taken * self._period:
            self._taken = math.floor((time + 1e-9) / self._period) + 1 if self._period > 0 else self._taken + 1
            self._under_way.append((time + self._delay, self._read(time)))
        newest = None
        while self._under_way and self._under_way[0][0] <= time + 1e-9:
            newest = self._under_way.popleft()[1]
        return newest
