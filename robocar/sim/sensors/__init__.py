"""The sensors of a robot: one file each."""
