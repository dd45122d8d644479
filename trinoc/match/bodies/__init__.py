"""Rims and cylinders by their circles and outlines, and the shadows that a lamp casts.

Each search makes hypotheses of what could be there, asks which segments support them, fits the
circle, the cylinder or the lamp, leaves out rivals, and answers with sigmas.
"""
