"""Corners, edges and planar faces as one graph: joined lines and their corners made consistent."""
