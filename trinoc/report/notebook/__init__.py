"""How values show themselves in a notebook: tables, small pictures, plots, figures to turn."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
