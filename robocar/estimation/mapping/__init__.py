"""Occupancy grid maps from sonars and lasers."""
