"""Estimates of the cameras over one sheet, with sheet, lenses and aims as unknowns.

`single_camera` fits one camera to its circles, `adjustment` all cameras together: outliers,
chi-square, covariance. `agreement` chooses grey levels or circles, `model_tests` and `prior_pulls`
test what is fixed and what has a prior, `better_knowledge` advises what to measure better."""
