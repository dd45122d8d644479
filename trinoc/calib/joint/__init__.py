"""Cameras and lines of space refined together, in one least-squares problem.

Sheet and segments speak through one objective: the sheet's fit by its estimate and
covariance, each fragment by the distances of its two ends from the projected line. Lines
are eliminated track by track (Schur complement), so that cost grows linearly with tracks.
"""
