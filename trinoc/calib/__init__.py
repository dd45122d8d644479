"""From images of a printed sheet or board to calibrated cameras with their covariance.

The inner rooms in the order of the work:

- `targets` (the boards) and `detection` (their circles and corners in an image);
- `problem` (lenses, cameras and boards fitted together) and `starts` (initial lenses and poses);
- `photometric` (the fit to the grey levels) and `adjustment` (all cameras over one sheet);
- `result` (what every calibration returns), `advice` (tests of a fit, and the next shot to take);
- `uncertainty` (errors that repeated images do not show);
- `bundle` (cameras and matched lines refined together) and `rig_check` (was a camera knocked?).

The files of this folder set up the unknowns of each calibration: `sheet_calibration` for one image
of the sheet per camera, `shots_fit` for many shots (`rig_calibration`, `lens_calibration`), and
`from_points` for points.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
