"""The cameras over one sheet, with everything that nobody knows exactly.

`each_camera` fits one by its circles (`crossed_lines` begin it), `estimate` all together: outliers,
chi-square, covariance. `agreement`, `jackknife` and `model_tests` ask whether that can be true."""
