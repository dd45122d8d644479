"""From a picture to labelled circles and lines of the sheet, step by step.

picture -> blobs -> neighbours -> lattice -> labels -> ellipse_fit -> lines, joined in
detect_pattern. Everything is plain NumPy and OpenCV on arrays of circles.
"""
