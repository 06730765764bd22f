"""Random streams: one seed per run, one child stream per component, found by name.

Adding a sensor or a particle filter to a run therefore changes no other component's numbers.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, component: str) -> np.random.Generator:
    """The generator of `component`, e.g. `sensor/sonar/front_left`, in the run with this seed."""
    digest = hashlib.sha256(component.encode()).digest()
    key = tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
