"""Cameras, rigs, conics, epipolar geometry, lines: pure functions of one item, vmap outside."""
