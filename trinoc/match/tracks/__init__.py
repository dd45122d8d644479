"""From selected candidates to `Matches`: more than three views, 3-D segments with covariance,
reasons.
"""
