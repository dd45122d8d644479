"""Step 1: triples of segments that can be one line.

transfer (what a pair predicts in the third view) -> index, lookup (who is there) -> gate: all by
search, in single_precision -> triples, all three orderings, in double precision; `table` is the
value they come in."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
