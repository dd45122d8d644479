"""What several rooms need and no library has: arrays, precision, buckets, small solvers.

Ground floor. Nothing here knows cameras, pictures or segments."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
