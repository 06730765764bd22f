"""Footprints, outlines, segments and polylines on a costmap."""
