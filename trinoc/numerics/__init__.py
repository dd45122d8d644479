"""Numerical tools shared by rooms: arrays, precision, buckets, small solvers.

Ground floor: no cameras, images or segments here.
"""
