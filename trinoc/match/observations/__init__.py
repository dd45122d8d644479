"""The caller's segments and rig, checked, undistorted, ordered, in padded tables; the clutter."""
