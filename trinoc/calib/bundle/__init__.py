"""Joint refinement of cameras and lines in space: bundle adjustment with lines.

The distances of each matched line's fragments are the observations; the calibration with the sheet
is the prior (`factors`). `joint_problem` is the problem for `calib.problem.solver`; `covariance`
determines gauge, errors and noise; `estimate` is one joint estimate; `refinement` runs rounds of
matching and other starts. `implicit_diff` gives the solution as a differentiable function of the
observations. Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000).
"""
