"""How a calibration problem begins: from what was detected to lenses, cameras and boards in place.

`pictures` finds the board in the pictures of all shots; `crossed_lines` gives a camera's pose over
the printed sheet; `camera_start` finds a first lens for each
camera, and the board before it; `sightings` are these with every labelling of the board. `links`
are poses between cameras, and boards, that shots agree on; `connected` chains them, by their
motions where no two see the same; `placing` puts the boards of all shots among the cameras, or says
why that is not possible."""
