"""Rims and cylinders by their circles and outlines.

Each search makes hypotheses of what could be there, asks which segments support them, fits the
circle or the cylinder, leaves out rivals, and answers with sigmas.
"""
