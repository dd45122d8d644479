"""From an image to labelled circles and lines of the sheet.

In the order of the work: grey -> blobs -> lattice -> ellipse_pixels, ellipse_fit, quality_gate ->
placing, labels -> read_pattern -> measure_circles -> cross_lines, all put together in `search`;
`orientation` chooses among the labellings of a sheet that looks the same turned."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
