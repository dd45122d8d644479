"""Errors of the sheet and the lens, and what cameras' errors do to epipolar lines and points."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
