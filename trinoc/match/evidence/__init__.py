"""Log likelihood ratios of one line against clutter, and the mixtures learned by EM.

triple_position: place and direction, of pairs too. endpoints: where ends lie along the line.
side_intensity: the darker side and the grey levels on both sides. mixture: their sum."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
