"""Time and memory of the harmonic solvers, beside PyAMG + CG on the same system.

`python -m robocar.benchmarks.bench_harmonic [--quick]` prints a table; `--quick` stops at N = 600. Times are medians (peers: one
run), compilation is not counted. Memory is the growth of a fresh process's peak over its peak on a small map, so imports and
compiled code do not count.
"""

from __future__ import annotations

import multiprocessing
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyamg
import scipy.sparse as sp

from robocar.experiments.harmonic_tables import OMEGA, PAPER, room_map
from robocar.planners.harmonic.laplace import LaplaceProblem, laplace_problem, solve, sweep

TOLERANCE = 1e-10

PLACES = {
    "across the way": (0.45, 0.70),
    "in a corner by the goal": (0.05, 0.95),
    "in the door": (0.22, 0.47),
    "dead end, goal's room": (0.90, 0.90),
    "dead end, other room": (0.90, 0.10),
}
"""Where an obstacle appears, as (row, column) in shares of the map: upstream of the goal, beside it, and far from any way."""


def timed(function: Callable[[], Any], runs: int) -> tuple[float, Any]:
    """Median seconds, and the last result."""
    seconds = []
    result = None
    for _ in range(runs):
        begin = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds), result


def whole(n: int, case: int = 1) -> Any:
    """From the map to the potential."""
    return solve(laplace_problem(*room_map(case, n)), TOLERANCE)


def system(problem: LaplaceProblem) -> tuple[Any, np.ndarray, np.ndarray]:
    """The five-point matrix in CSR form, the right side, and the flat places of the unknowns."""
    padded = problem.inverse_degree
    places = np.flatnonzero(padded)
    number = np.full(padded.size, -1, dtype=np.int32)
    number[places] = np.arange(len(places))
    start = problem.start_field().ravel()
    right = np.zeros(len(places))
    i: list[Any] = [np.arange(len(places))]
    j: list[Any] = [np.arange(len(places))]
    values = [1.0 / padded.ravel()[places]]
    for offset in (1, -1, padded.shape[1], -padded.shape[1]):
        beside = number[places + offset]
        right += start[places + offset]
        inside = np.flatnonzero(beside >= 0)
        i.append(inside)
        j.append(beside[inside])
        values.append(np.full(len(inside), -1.0))
    shape = (len(places), len(places))
    return sp.csr_matrix((np.concatenate(values), (np.concatenate(i), np.concatenate(j))), shape=shape), right, places


def peer(n: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Seconds of PyAMG's set-up and CG to a norm-wise 1e-12 (the matrix is there already), its w and the places."""
    matrix, right, places = system(laplace_problem(*room_map(1, n)))
    begin = time.perf_counter()
    w = np.asarray(pyamg.ruge_stuben_solver(matrix).solve(right, tol=1e-12, accel="cg"))
    return time.perf_counter() - begin, w, places


def _status(key: str) -> int:
    """A size from the process's status [bytes] (Linux)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(key))


def _peak(n: int, pipe: Any) -> None:
    whole(60)
    blocked, goal = room_map(1, n)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before = _status("VmRSS")
    solve(laplace_problem(blocked, goal), TOLERANCE)
    pipe.send(_status("VmHWM") - before)


def bytes_per_cell(n: int) -> float:
    """Growth of the peak memory of a process that solves N = n, per cell of the map."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_peak, args=(n, there))
    process.start()
    there.close()  # or a child that dies would leave us waiting
    grown = here.recv()
    process.join()
    return grown / n**2


def local_change(n: int, place: tuple[float, float], runs: int) -> tuple[float, float, int, float]:
    """Seconds of the first solve and of one after a 20 x 20 obstacle appeared at `place`, both from the map on; and more.

    Returns also the cycles of the second, and the share of the cells in which w changed by more than 1 %.
    """
    blocked, goal = room_map(1, n)
    row, col = round(place[0] * n), round(place[1] * n)
    changed = blocked.copy()
    changed[row : row + 20, col : col + 20] = True
    begin, again = [], []
    old = new = solve(laplace_problem(blocked, goal), TOLERANCE)
    for _ in range(runs):  # in turns, so that both see the machine alike
        seconds, old = timed(lambda: solve(laplace_problem(blocked, goal), TOLERANCE), 1)
        begin.append(seconds)
        seconds, new = timed(lambda old=old: solve(laplace_problem(changed, goal), TOLERANCE, guess=old), 1)
        again.append(seconds)
    free = new.problem.unknowns
    moved = float(np.mean(np.abs(new.w[free] / old.w[free] - 1) > 0.01))
    return statistics.median(begin), statistics.median(again), len(new.residuals), moved


def say(line: str) -> None:
    """One line of the table, at once."""
    print(line, flush=True)


def main(quick: bool = False) -> None:
    """Print the table."""
    sizes = (300, 600) if quick else (300, 600, 900, 1200, 1500, 1800)
    runs = 3
    whole(60)
    whole(300)
    whole(300, case=2)
    largest = sizes[-1]
    per_cell = {}
    say(f"fast solver to a component-wise residual of {TOLERANCE}, from the map to the potential, median of {runs}")
    for n in sizes:
        seconds, potential = timed(lambda n=n: whole(n), runs)
        per_cell[n] = seconds / n**2
        say(f"  N = {n:5}: {seconds:7.3f} s, {1e9 * per_cell[n]:5.0f} ns a cell, {len(potential.residuals)} cycles")
    say(f"  time per cell, N = {largest} against {sizes[0]}: {per_cell[largest] / per_cell[sizes[0]]:.2f} (target < 1.5)")
    say(f"  memory: {bytes_per_cell(largest):.0f} bytes a cell (target 80)")
    seconds, w, places = peer(largest)
    exact = solve(laplace_problem(*room_map(1, largest))).mantissa.ravel()[places]
    wrong = 100 * np.mean(np.abs(w / exact - 1) > 1e-8)
    ours = per_cell[largest] * largest**2
    say(f"PyAMG + CG to 1e-12: {seconds:.2f} s; ours is {ours / seconds:.2f} of it (target 0.5)")
    say(f"  {wrong:.1f} % of its cells are off by more than 1e-8")
    sweep(laplace_problem(*room_map(1, 1300)), "quarter", "sor", OMEGA, tolerance=1e-3)
    problem = laplace_problem(*room_map(1, largest))
    begin = time.process_time()
    found = sweep(problem, "quarter", "sor", OMEGA)
    spent = time.process_time() - begin
    paper_k, paper_t = PAPER[1, "quarter"][(300, 600, 900, 1200, 1500, 1800).index(largest)]
    ours = spent / found.iterations * paper_k
    say(f"QSSOR, N = {largest}: {found.iterations} iterations in {spent:.2f} s")
    say(f"  the paper's {paper_k} would take {ours:.2f} s, {paper_t / ours:.0f} times less than its {paper_t} s (target 40)")
    n = min(900, largest)
    say(f"a 20 x 20 obstacle appears, N = {n} (target: 0.2 of the first solve)")
    for name, place in PLACES.items():
        first, second, cycles, moved = local_change(n, place, runs)
        told = f"{first:.3f} s, then {second:.3f} s in {cycles} cycles: {second / first:.2f}"
        say(f"  {name:24}: {told}, w moved in {100 * moved:.0f} % of the map")


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
