"""From an image to the labelled places of a board, with their covariances.

`registry` says which detector belongs to which board. That of sheets of circles, `circles`, in the
order of its work: search_image -> blobs -> lattice -> ellipse_pixels, ellipse_fit, quality_gate ->
labels -> measure_circles -> cross_lines; `orientation` chooses among the labellings of a sheet that
looks the same turned. Those of boards of squares end in corners -> corner_fit -> window_noise."""
