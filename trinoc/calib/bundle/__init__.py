"""Cameras and lines in space refined together: bundle adjustment with lines.

Each matched line enters by the distances of its fragments, the sheet as a prior: its estimate and
covariance (factors). joint_problem (what `calib.problem` solves) -> covariance (gauge, errors,
noise) -> estimate -> refinement (rounds of matching, other starts); implicit_diff is the answer as
a differentiable function of the observations. Source: Triggs et al.,
"Bundle adjustment: a modern synthesis" (2000)."""
