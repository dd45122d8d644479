"""Joint refinement of cameras and lines in space: bundle adjustment with lines.

The distances between detected segments and projected lines are the observations; the calibration
with the sheet is the prior (`factors`). `joint_problem` is the problem for `calib.problem.solver`;
`covariance` determines gauge, errors and noise; `estimate` is one joint estimate; `refinement` runs
rounds of matching from several initial rigs. `implicit_diff` gives the solution as a differentiable
function of the observations. Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000).
"""
