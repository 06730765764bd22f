"""Tables 1 and 2 of Saudi and Sulaiman: iterations and seconds of full-, half- and quarter-sweep SOR on two room maps.

The paper's maps (Rajah 5) are drawings; `room_map` draws two in their spirit, the same at every N. Each scheme runs with one
fixed omega on all sizes, as the paper's numbers show that it did (iterations grow like N^2), and with the best one (they grow
like N); the threshold is the paper's 1e-15, or with the best omega what doubles reach. The fast solver and its component-wise
residual stand beside them, and octo-sweep, EDG and MEG, the paper's future work, at the smallest size.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from robocar.planners.harmonic.laplace import Sweeps, best_omega, block_sweep, laplace_problem, solve, sweep
from robocar.planners.harmonic.laplace.lattice import Scheme
from robocar.reporting.report import Report
from robocar.reporting.terminal import say

SIZES = (300, 600, 900, 1200, 1500, 1800)
SCHEMES: dict[Scheme, str] = {"full": "FSSOR", "half": "HSSOR", "quarter": "QSSOR"}
OMEGA = 1.87
"""Fixed on all maps: full sweeps at N = 300 then take about as many iterations as the paper's."""

PAPER = {
    (1, "full"): ((2804, 5.64), (10686, 99.78), (23218, 553.55), (40322, 1720.28), (61840, 4190.00), (87686, 8605.36)),
    (1, "half"): ((1426, 1.52), (5473, 25.44), (11915, 147.75), (20698, 471.20), (31780, 1137.26), (45065, 2328.05)),
    (1, "quarter"): ((709, 0.26), (2804, 6.19), (6135, 33.11), (10665, 120.70), (16373, 306.44), (23218, 628.84)),
    (2, "full"): ((2189, 4.59), (8331, 79.06), (18130, 446.23), (31473, 1398.06), (48258, 3415.03), (68431, 7017.78)),
    (2, "half"): ((1109, 1.19), (4260, 21.52), (9299, 121.83), (16153, 383.69), (24786, 927.31), (35158, 1902.27)),
    (2, "quarter"): ((542, 0.22), (2189, 5.03), (4781, 27.08), (8331, 99.86), (12764, 249.02), (18130, 512.30)),
}
"""Jadual 1: (iterations, seconds) at each size."""


def room_map(case: int, n: int) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """Blocked cells (n, n) and the goal's cell of case 1 (two rooms) or 2 (four), with inner walls and obstacles."""
    blocked = np.zeros((n, n), dtype=bool)

    def block(top: float, bottom: float, left: float, right: float, value: bool = True) -> None:
        blocked[round(top * n) : round(bottom * n), round(left * n) : round(right * n)] = value

    thick = 0.02
    block(0, 1, 0.5, 0.5 + thick)
    block(0.18, 0.30, 0.5, 0.5 + thick, False)  # the door between the rooms
    if case == 1:
        block(0.35, 0.35 + thick, 0, 0.33)
        block(0.66, 0.66 + thick, 0.17, 0.5)
        block(0.55, 0.55 + thick, 0.64, 1)
        block(0.76, 0.86, 0.74, 0.84)
        block(0.12, 0.21, 0.18, 0.27)
        block(0.30, 0.38, 0.78, 0.86)
        return blocked, (round(0.12 * n), round(0.88 * n))
    block(0.48, 0.48 + thick, 0, 1)
    block(0.48, 0.48 + thick, 0.20, 0.32, False)
    block(0.48, 0.48 + thick, 0.74, 0.86, False)
    block(0.10, 0.20, 0.12, 0.22)
    block(0.26, 0.34, 0.34, 0.42)
    block(0.62, 0.80, 0.24, 0.26)
    block(0.64, 0.72, 0.64, 0.74)
    block(0.14, 0.16, 0.62, 0.82)
    block(0.80, 0.90, 0.82, 0.90)
    return blocked, (round(0.86 * n), round(0.12 * n))


def main(out: Path, quick: bool = False) -> None:
    """Write tables and convergence curves to `out`; `quick` stops at N = 600."""
    out = Path(out)
    report = Report(out, "Harmonic functions: iterations and seconds of the sweep schemes")
    sizes = SIZES[:2] if quick else SIZES
    curves = {}
    for case in (1, 2):
        fixed = {}
        rows = []
        for k, n in enumerate(sizes):
            problem = laplace_problem(*room_map(case, n))
            for scheme, name in SCHEMES.items():
                # compile outside the clock; small lattices do without the passes of several iterations
                sweep(laplace_problem(*room_map(case, sizes[0])), scheme, "sor", 1.5, tolerance=1e-3)
                seconds, found = _timed(lambda p=problem, s=scheme: sweep(p, s, "sor", OMEGA, tolerance=1e-15))
                fixed[scheme, n] = found.iterations, seconds
                omega = best_omega(problem, scheme)
                best_seconds, best = _timed(lambda p=problem, s=scheme, w=omega: sweep(p, s, "sor", w))
                paper_k, paper_t = PAPER[case, scheme][k]
                rows.append((name, n, found.iterations, seconds, omega, best.iterations, best_seconds, paper_k, paper_t))
                report.number(f"case{case}/{name}/{n}/iterations", found.iterations, "1", paper_k)
                report.number(f"case{case}/{name}/{n}/seconds", seconds, "s", paper_t)
                report.number(f"case{case}/{name}/{n}/best_iterations", best.iterations, "1")
                report.number(f"case{case}/{name}/{n}/best_seconds", best_seconds, "s")
                say(f"case {case}, N = {n}, {name}: {found.iterations} iterations in {seconds:.1f} s")
                if n == sizes[0]:
                    curves[case, name, f"ω = {OMEGA}"], curves[case, name, "best ω"] = found.changes, best.changes
            seconds, potential = _fast(problem)
            rows.append(("multigrid", n, len(potential.residuals), seconds, None, None, None, None, None))
            report.number(f"case{case}/multigrid/{n}/seconds", seconds, "s")
            report.number(f"case{case}/multigrid/{n}/residual", potential.residual, "1")
        header = ("method", "N", "k", "t [s]", "best ω", "k at best ω", "t [s]", "paper k", "paper t [s]")
        report.table(header, rows, f"Case {case}: iterations k and seconds t at ω = {OMEGA} (table 1)")
        _reductions(report, case, sizes, fixed)
    _future_work(report)
    _draw(out, curves)
    report.write()


def _timed(method: Callable[[], Sweeps]) -> tuple[float, Sweeps]:
    """t of table 1 with what was found; processor time, so what else the machine does is not counted."""
    begin = time.process_time()
    found = method()
    return time.process_time() - begin, found


def _fast(problem):
    """Seconds and potential of the default solver at a component-wise residual of 1e-10, the better of two runs."""
    runs = []
    for _ in range(2):
        begin = time.perf_counter()
        potential = solve(problem, 1e-10)
        runs.append((time.perf_counter() - begin, potential))
    return min(runs, key=lambda run: run[0])


def _reductions(report: Report, case: int, sizes: tuple[int, ...], found: dict[tuple[Scheme, int], tuple[int, float]]) -> None:
    """Table 2, from iterations and seconds of each scheme at each size."""
    rows = []
    for scheme in ("half", "quarter"):
        for what, index in (("iterations", 0), ("seconds", 1)):
            measured, published = [], []
            for k, n in enumerate(sizes):
                measured.append(100 * (1 - found[scheme, n][index] / found["full", n][index]))
                published.append(100 * (1 - PAPER[case, scheme][k][index] / PAPER[case, "full"][k][index]))
            rows.append((SCHEMES[scheme], what, _span(measured), _span(published)))
            for name, values, pick in (("min", measured, min), ("max", measured, max)):
                report.number(f"case{case}/{SCHEMES[scheme]}/{what}_reduction_{name}", pick(values), "%", pick(published))
    report.table(
        ("method", "of", "reduction [%]", "paper [%]"), rows, f"Case {case}: reductions against FSSOR at equal ω (table 2)"
    )


def _span(values: list[float]) -> str:
    return f"{min(values):.2f} – {max(values):.2f}"


def _future_work(report: Report) -> None:
    rows = []
    problem = laplace_problem(*room_map(1, 300))
    methods: dict[str, Callable[[], Sweeps]] = {
        "octo-sweep SOR": lambda: sweep(problem, "octo", "sor", OMEGA),
        "EDG, over-relaxed": lambda: block_sweep(problem, "EDG", OMEGA),
        "MEG, over-relaxed": lambda: block_sweep(problem, "MEG", OMEGA),
    }
    for name, method in methods.items():
        seconds, found = _timed(method)
        rows.append((name, found.iterations, seconds))
        report.number(f"case1/{name}/300/iterations", found.iterations, "1")
    report.table(("method", "k", "t [s]"), rows, f"The paper's future work: case 1, N = 300, ω = {OMEGA}")


def _draw(out: Path, curves: dict[tuple[int, str, str], NDArray[np.float64]]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.5), sharex=True, sharey=True)
    colors = dict(zip(SCHEMES.values(), ("C0", "C1", "C2"), strict=True))
    for (case, name, omega), changes in curves.items():
        seen = np.flatnonzero(np.isfinite(changes))
        style = "--" if omega == "best ω" else "-"
        panels[case - 1].semilogy(seen + 1, changes[seen], style, color=colors[name], label=f"{name}, {omega}", lw=1)
    for case, axes in enumerate(panels, start=1):
        axes.set(xlabel="iteration", title=f"case {case}, N = {SIZES[0]}", xscale="log")
        axes.legend(fontsize=7)
    panels[0].set_ylabel("largest change")
    figure.tight_layout()
    figure.savefig(out / "convergence.png", dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
