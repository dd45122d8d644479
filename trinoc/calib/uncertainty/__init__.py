"""Systematic errors of sheet and lens, and the effect of camera errors on epipolar lines and
points.
"""
