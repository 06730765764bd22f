"""Paths down a harmonic potential: the planner, its local variant, streamlines."""
