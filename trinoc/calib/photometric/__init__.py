"""The sheet's image as a differentiable model, fitted to the pixels near ink edges.

outlines, pixel_selection -> rays, sheet_point -> edges, ink_coverage, line_pixels -> appearance
-> normal_equations, gauss_newton -> image_problem, gate -> ideal_fit -> image_refinement,
image_fit (one image) -> views (all of them).

Where the residuals refute an ideal camera (refutation): kernels -> camera_look ->
unknowns, local_light, camera_scene -> clipped_noise, noise_by_level, camera_steps ->
correlated_noise, camera_evidence -> camera_covariance, camera_fit -> found. encoding and
mosaic stand before all of it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
