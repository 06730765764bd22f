"""Rajah 5 of Saudi and Sulaiman (paths from several starts on both room maps), and a maze in which the plain potential goes flat.

Completeness is counted as well: random starts on benchmark maps and on generated mazes from which gradient descent reaches the
goal, for the potential here and for the plain one, u = 1 - w in doubles, as an absolute threshold of 1e-15 leaves it.
"""

from __future__ import annotations

import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import NoPathFound
from robocar.experiments.harmonic_tables import OMEGA, room_map
from robocar.formats.generated import maze
from robocar.formats.movingai import load_movingai_map
from robocar.planners.harmonic.laplace import Potential, laplace_problem, solve, sweep
from robocar.planners.harmonic.streamline import descend, streamline
from robocar.reporting.report import Report

STARTS = {
    1: ((0.90, 0.10), (0.05, 0.05), (0.50, 0.30), (0.92, 0.90), (0.62, 0.92)),
    2: ((0.05, 0.95), (0.10, 0.05), (0.90, 0.95), (0.40, 0.60)),
}
"""Of the figure, as fractions of the map (row, col)."""


def main(out: Path, quick: bool = False) -> None:
    """Write figures and the counts to `out`; `quick` takes fewer starts."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    report = Report(out, "Harmonic functions: paths and completeness")
    _paths(out, report)
    _maze(out)
    _completeness(report, starts=1_000 if quick else 10_000)
    report.write()


def _paths(out: Path, report: Report) -> None:
    n = 300
    figure, axes = plt.subplots(1, 2, figsize=(13, 6.5))
    rows = []
    for case, ax in zip((1, 2), axes, strict=True):
        blocked, goal = room_map(case, n)
        problem = laplace_problem(blocked, goal)
        potential = solve(problem)
        quarter = sweep(problem, "quarter", "sor", OMEGA).potential
        _heat(ax, potential)
        for start in STARTS[case]:
            cell = (round(start[0] * n), round(start[1] * n))
            line = streamline(potential, (cell[1] + 0.5, cell[0] + 0.5))
            cells = descend(quarter, cell)
            ax.plot(*line.T, color="white", lw=1.5)
            ax.plot(cells[:, 1] + 0.5, cells[:, 0] + 0.5, color="black", lw=0.7, ls="--")
            ax.plot(cell[1], cell[0], "gs", ms=7)
            rows.append((case, cell, len(cells), float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())))
        ax.plot(goal[1], goal[0], "ro", ms=8)
        ax.set_title(f"case {case}: log10 w, streamlines (white), QSSOR and descent on cells (dashed)", fontsize=9)
    figure.savefig(out / "paths.png", dpi=130, bbox_inches="tight")
    plt.close(figure)
    report.table(
        ("case", "start", "cells of the QSSOR path", "streamline [cells]"), rows, "Rajah 5: every start reaches the goal"
    )


def _maze(out: Path) -> None:
    free = maze(80, 80, 3, np.random.default_rng(1)).free
    potential = solve(laplace_problem(~free, (1, 1)))
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 6.5))
    plain = np.where(free, 1.0 - potential.w, np.nan)
    with np.errstate(divide="ignore"):
        left.imshow(np.log10(1.0 - plain), origin="lower", cmap="viridis")
    left.set_title("plain: log10(1 - u) of u in doubles; white: u is exactly 1, flat", fontsize=9)
    _heat(right, potential)
    line = streamline(potential, _farthest(potential)[::-1] + 0.5)
    right.plot(*line.T, color="white", lw=1)
    right.set_title("log10 w and the streamline from the farthest cell", fontsize=9)
    figure.savefig(out / "maze.png", dpi=130, bbox_inches="tight")
    plt.close(figure)


def _heat(ax, potential: Potential) -> None:
    decades = potential.log2 * np.log10(2.0)
    ax.imshow(np.where(np.isfinite(decades), decades, np.nan), origin="lower", cmap="viridis", extent=_extent(potential))


def _extent(potential: Potential) -> tuple[float, float, float, float]:
    rows, cols = potential.problem.shape
    return 0.0, float(cols), 0.0, float(rows)


def _farthest(potential: Potential) -> NDArray[np.int64]:
    log2 = np.where(potential.problem.unknowns, potential.log2, np.inf)
    return np.array(np.unravel_index(np.argmin(log2), log2.shape))


def _completeness(report: Report, starts: int) -> None:
    rng = np.random.default_rng(0)
    maps = {f"maze, corridor {c}": maze(512, 512, c, rng).free for c in (1, 2, 4, 8, 16)}
    data = Path(os.environ.get("ROBOCAR_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data") / "movingai"
    for file in sorted(data.glob("*.map")):
        maps[file.stem] = load_movingai_map(file).free
    share = starts // len(maps) + 1
    rows = []
    reached = plainly = total = 0
    for name, free in maps.items():
        cells = np.argwhere(free)
        goal = cells[rng.integers(len(cells))]
        potential = solve(laplace_problem(~free, goal))
        unknown = np.argwhere(potential.problem.unknowns)
        chosen = unknown[rng.integers(len(unknown), size=share)]
        ours = sum(_reaches(potential, (int(r), int(c))) for r, c in chosen)
        u = np.pad(1.0 - potential.w, 1, constant_values=1.0)
        plain = sum(_plain_descent(u, int(r) + 1, int(c) + 1) for r, c in chosen)
        rows.append((name, f"{free.shape[0]} x {free.shape[1]}", share, ours, plain, potential.method))
        reached, plainly, total = reached + ours, plainly + plain, total + share
    report.table(("map", "cells", "starts", "reached", "plain method", "solver"), rows, "Random starts that reach the goal")
    report.number("completeness", 100 * reached / total, "%", 100.0)
    report.number("completeness_plain", 100 * plainly / total, "%")
    report.number("starts", total, "1")


def _reaches(potential: Potential, start: tuple[int, int]) -> bool:
    try:
        return bool(potential.w[tuple(descend(potential, start)[-1])] == 1.0)
    except NoPathFound:
        return False


@njit(cache=True)
def _plain_descent(u, r, c):
    """Whether descent on the padded potential u reaches 0: to the lowest of eight neighbours, no corner cutting."""
    while u[r, c] > 0.0:
        low, r2, c2 = u[r, c], r, c
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                corner = dr != 0 and dc != 0 and (u[r + dr, c] == 1.0 or u[r, c + dc] == 1.0)
                if not corner and u[r + dr, c + dc] < low:
                    low, r2, c2 = u[r + dr, c + dc], r + dr, c + dc
        if r2 == r and c2 == c:
            return False
        r, c = r2, c2
    return True


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
