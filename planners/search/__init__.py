"""Paths on grids: A*, Theta*, D* Lite, Dynamic A*, path transforms, and the grid search that they share."""
