"""Fit of a differentiable model of the sheet's image to the grey levels near ink edges.

Files in their order of use:
unknowns; sheet_geometry -> edges, ink -> grey_level (model of one pixel) -> noise, equations (all
pixels) -> descent (compiled programs). square_pixels, pixel_selection, encoding -> scene (constants
of a fit) -> fit_state -> gate, evidence -> fit -> covariance, patches -> image_fit (one image) ->
views (all images), sentences (messages).

The ideal camera model (`unknowns.IDEAL`) has a subset of the unknowns of the full camera model
(`unknowns.FULL`). If its residuals refute it, further unknowns are estimated. `encoding` has the
known properties of the images, `grey_level.grey_level` the response curve.
"""
