"""Cameras and lines in space refined together: bundle adjustment with lines.

The sheet enters as a prior, its estimate and covariance (pose_prior); each matched line by the
distances of its fragments (line_residual). problem -> schur, levenberg_marquardt -> estimate ->
gauge, variance_components, line_covariance -> multi_start, model_evidence -> refinement;
implicit_diff is the answer as a differentiable function of the observations. Source: Triggs et al.,
"Bundle adjustment: a modern synthesis" (2000)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
