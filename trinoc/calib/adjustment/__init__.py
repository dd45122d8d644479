"""All cameras over one sheet adjusted together, with everything that nobody knows exactly.

`sheet_shape` (print and bend) -> `least_squares` (poses, lenses and sheet, with their priors) ->
`estimate` (outliers, chi-square, covariance)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
