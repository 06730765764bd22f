"""Costmaps for the tests of the planners."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import strategies as st
from scipy.sparse import csr_array

from robocar.core import SE2, Costmap

ORIGINS = (SE2(), SE2(-3.0, 2.0, 0.7))


def random_costs(seed: int, rows: int, cols: int, blocked: float, weighted: bool) -> np.ndarray:
    """(rows, cols) uint8 with a share of blocked cells, 253 to 255."""
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 253, (rows, cols)) if weighted else np.zeros((rows, cols), dtype=int)
    walls = rng.random((rows, cols)) < blocked
    costs[walls] = rng.integers(253, 256, (rows, cols))[walls]
    return costs.astype(np.uint8)


@st.composite
def costmaps(draw: st.DrawFn) -> Costmap:
    """Small random costmaps, weighted or not, shifted and rotated or not."""
    costs = random_costs(
        draw(st.integers(0, 2**32 - 1)),
        draw(st.integers(1, 14)),
        draw(st.integers(1, 14)),
        draw(st.sampled_from([0.0, 0.15, 0.35, 0.5])),
        draw(st.booleans()),
    )
    return Costmap(costs, draw(st.sampled_from([0.05, 1.0])), draw(st.sampled_from(ORIGINS)))


def free_pair(costmap: Costmap, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Two free cells (row, col), which may be the same; None where there is none."""
    cells = np.argwhere(~costmap.blocked)
    if len(cells) == 0:
        return None
    i, j = np.random.default_rng(seed).integers(len(cells), size=2)
    return cells[i], cells[j]


def step_graph(costmap: Costmap) -> csr_array:
    """The steps of the design as a sparse graph, written down naively: length times 1 + mean cost / 252 [m], no corner cut."""
    blocked, costs = costmap.blocked, costmap.data.astype(float)
    rows, cols = costmap.shape
    sources, targets, lengths = [], [], []
    for r in range(rows):
        for c in range(cols):
            for dr in (-1, 0, 1):
                for dc in (-1, 0, 1):
                    a, b = r + dr, c + dc
                    if (dr, dc) == (0, 0) or not (0 <= a < rows and 0 <= b < cols) or blocked[r, c] or blocked[a, b]:
                        continue
                    if blocked[r, b] or blocked[a, c]:
                        continue
                    sources.append(r * cols + c)
                    targets.append(a * cols + b)
                    lengths.append(np.hypot(dr, dc) * (1 + (costs[r, c] + costs[a, b]) / 2 / 252) * costmap.resolution)
    return csr_array((lengths, (sources, targets)), shape=(rows * cols, rows * cols))


def crosses_blocked(costmap: Costmap, points: np.ndarray) -> bool:
    """Whether samples every 1/50 cell along a polyline (n, 2) [m] lie in blocked cells or outside."""
    for a, b in itertools.pairwise(points):
        n = 2 + int(np.linalg.norm(b - a) / costmap.resolution * 50)
        samples = a + np.linspace(0, 1, n)[:, None] * (b - a)
        cells = costmap.cell_from_world(samples)
        if not costmap.contains(cells).all() or costmap.blocked[cells[:, 0], cells[:, 1]].any():
            return True
    return False
