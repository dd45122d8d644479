"""The cameras over one sheet, with everything that nobody knows exactly.

`each_camera` fits one by its circles, `estimate` all together: outliers, chi-square, covariance.
`agreement` and `model_tests` ask whether that can be true, `better_knowledge` what would
say more."""
