"""From what was selected to `Matches`: more views, 3-D segments with covariance, reasons."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
