"""Has a camera been knocked? By a scene's segments, or by comparing two calibrations."""
