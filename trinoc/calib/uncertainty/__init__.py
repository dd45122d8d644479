"""Errors of the sheet and the lens, and what cameras' errors do to epipolar lines and points."""
