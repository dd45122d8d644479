"""The sheet's image as a differentiable model, fitted to the pixels near ink edges.

unknowns; sheet_places -> edges, ink -> grey_level (one pixel) -> noise, equations (all of them) ->
descent (the compiled programs). square_pixels, pixel_selection, encoding -> scene (what a fit holds
fixed) -> fit_state -> gate, evidence -> fit -> covariance, patches -> image_fit (one picture) ->
views (all of them).

An ideal camera is the delivered one with unknowns left out (`unknowns.IDEAL`); where its residuals
refute it, they are freed. What is known of a camera's response stands in `encoding`, its curve in
`grey_level.grey_level` alone."""
