"""Step 0 of the method: one image to line segments.

`find_segments` is the chain of Nevatia and Babu (1980) with sub-pixel lines and covariance,
`find_segments_lsd` OpenCV's detector with its bias taken out. `find_junctions` says where segments
meet, `with_side_levels` adds the grey levels on both sides. Segments of any other detector are
an (n, 4) array and need nothing from here."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
