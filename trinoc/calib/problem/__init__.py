"""One calibration problem: variables on manifolds, factors that observe them, one solver.

`solve` minimises whatever has a cost, Gauss-Newton equations that form a block arrow, and steps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
