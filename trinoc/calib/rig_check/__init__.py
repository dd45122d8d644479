"""Tests whether a camera was moved: from the segments of a scene, or from a second calibration."""
