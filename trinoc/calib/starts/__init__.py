"""Initial lenses, cameras and boards for the calibration problem, from detections.

- `pictures`: detection of the board in the images of all shots.
- `crossed_lines`: pose of a camera over the printed sheet.
- `camera_start`: initial lens of each camera, and the board's pose in each of its images.
- `sightings`: these poses with every labelling (assignment of detected points to board points).
- `links`: relative poses of cameras, and of boards, on which shots agree.
- `connected`: chains of links; motions connect cameras that never see the same board.
- `placing`: poses of the boards of all shots among the cameras, or the reason why there are none.
"""
