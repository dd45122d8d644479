"""Step 1: triples of segments that can be one line.

transfer (what a pair predicts in the third view) -> index, lookup (who is there) -> gate: all by
search, in single_precision -> judged, in double precision, the value of `table`: for all three
orderings by triples."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
