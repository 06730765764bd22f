"""Costmaps: layers of the map, of what is seen and of inflation; known space."""
