"""The calibration problem: variables on manifolds, residuals with priors, and one solver.

- `variables`: lenses, cameras, boards, and their priors; `sheet` bends a board.
- `views`: observations of the board; `reprojection`: residuals of board points, used by all fits.
- `equations`: normal equations of all observations; `solver`: minimisation.
- `problem`: all of these in one value; `starting_problem` builds it, `robust_fit` removes outliers.
- `information`: information of each shot; `named_covariance`: covariance of public parameters.
- `rao_test`: score tests of fixed parameters.
"""
