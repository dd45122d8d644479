"""Accuracy of 3-D lines: comparison with known shapes, synthetic scenes and published matches."""
