"""Right circular cylinders by their outlines, which are another line in each view."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
