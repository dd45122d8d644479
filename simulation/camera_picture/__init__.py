"""Pictures of the printed sheet as cameras deliver them, to test calibration with.

Nothing of what is fitted is used: light, lens, sensor and processing are each modelled by their
physics, in the order in which they act. One file holds one of them:

1. `surfaces`, `paper`   how the sheet lies and what is printed on it, in `shapes` and `layers`
2. `light`               lamp, vignetting, glare, shadow
3. `sheet_view`          the lens: which point of the print each pixel shows
4. `scene`               light from the sheet, edges shared exactly by fine cells
5. `optics`              blur, motion and the pixel's box: light on each pixel
6. `sensor`              exposure, colour mosaic, noise, saturation
7. `demosaic`, `denoise` colour from the mosaic, noise smoothed away
8. `response`            grey levels against light
9. `delivery`            sharpening, rounding to bits, JPEG

`render` runs them one after the other; its `Condition` is how a picture is taken."""
