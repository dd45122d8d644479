"""Step 0: check, undistort and sort the caller's segments, build padded tables, fit the clutter
model.
"""
