"""The printed sheet: its circles and crossed lines, its ring code, and how it was printed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
