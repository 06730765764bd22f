"""Laplace's equation on the free cells of a grid: the paper's iterations, and solvers that are exact in every cell."""

from planners.laplace.blocks import block_sweep
from planners.laplace.multigrid import Multigrid
from planners.laplace.problem import LaplaceProblem, laplace_problem
from planners.laplace.solver import Potential, solve
from planners.laplace.sweeps import Sweeps, best_omega, sweep

__all__ = ["LaplaceProblem", "Multigrid", "Potential", "Sweeps", "best_omega", "block_sweep", "laplace_problem", "solve", "sweep"]
