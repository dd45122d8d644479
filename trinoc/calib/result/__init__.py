"""The answer of a calibration: status, cameras, covariance, and what each fit says."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
