"""Robust estimates of scale."""

# Standard deviation over median absolute deviation, of a Gaussian.
MAD_TO_SIGMA = 1.4826
