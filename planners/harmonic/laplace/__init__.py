"""Laplace's equation on the free cells of a grid: the paper's iterations, and solvers that are exact in every cell."""

from robocar.planners.harmonic.laplace.blocks import block_sweep
from robocar.planners.harmonic.laplace.multigrid import Multigrid
from robocar.planners.harmonic.laplace.problem import LaplaceProblem, laplace_problem
from robocar.planners.harmonic.laplace.solver import Potential, solve
from robocar.planners.harmonic.laplace.sweeps import Sweeps, best_omega, sweep

__all__ = ["LaplaceProblem", "Multigrid", "Potential", "Sweeps", "best_omega", "block_sweep", "laplace_problem", "solve", "sweep"]
