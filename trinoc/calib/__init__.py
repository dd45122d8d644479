"""From a picture of the printed sheet to calibrated cameras with covariance.

In the order of the work: `targets` (the boards) -> `detection` (their places in an image) ->
`problem` (lenses, cameras and boards fitted together) -> `starts` (how it begins) -> `photometric`
(the fit to the grey levels) -> `adjustment` (the cameras over one sheet) -> `result` (what every
calibration returns). `advice` says what a fit is worth and what to show next, `uncertainty` holds
errors that no repetition shows.
`bundle` refines cameras and matched lines together, `rig_check` asks whether a camera was knocked.
The files of this folder say which variables there are and what is free: `sheet_calibration`
for one image of the sheet per camera, `shots_fit` for many shots (`rig_calibration`,
`lens_calibration`), `from_points` for points."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
