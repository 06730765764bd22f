"""Planners, a room for each family; they see `robocar.core` only, and are silent."""
