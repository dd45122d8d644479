"""After matching: collinear tracks as one line, ends that meet as corners, depth maps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
