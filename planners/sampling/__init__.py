"""Random trees: RRT, RRT-Connect, RRT*."""
