"""One camera's pose from its circles or from given points, by Levenberg-Marquardt.

initial (from the crossed lines) -> least_squares -> views (all views at once, outliers dropped) ->
estimate (rank, covariance, status) -> score (what the residuals say of everything held fixed)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
