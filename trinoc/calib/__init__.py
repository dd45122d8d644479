"""From a picture of the printed sheet to calibrated cameras with covariance.

In the order of the work: `targets` (the sheet) -> `detection` (its circles in an image) -> `model`
(how a camera sees a circle) -> `pose` (least squares over circles or points) -> `photometric`
(the fit to the grey levels) -> `uncertainty` (errors that no repetition shows) -> `result`.
`problem` is the fit of lenses, cameras and boards together, `starts` how it begins, `advice` what
it is worth and what to show next; `rig_calibration` and `lens_calibration` say what is free.
`bundle` refines cameras and matched lines together, `rig_check` asks whether a camera was knocked.
Other files of this folder put the rooms together over one sheet: `from_images`, `from_detections`,
`from_points`, `batch`, `messages`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
