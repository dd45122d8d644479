"""Detection of boards: one image to labelled points of a board, with covariances.

`registry` has the detector of each kind of board. The detector of sheets, `circles`, uses in this
order: search_image -> blobs -> lattice -> ellipse_pixels, ellipse_fit, quality_gate -> labels ->
measure_circles -> cross_lines. `orientation` resolves the labelling of a rotationally symmetric
sheet. The detectors of chessboards and of boards with markers (`chessboard`, `marker_boards`) end
with corners -> corner_fit -> window_noise. `usable_points` checks every detection.
"""
