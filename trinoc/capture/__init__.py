"""Advice while images are taken: quality of each image, and a goal for the next one.

`measures` has exposure, sharpness, covered field and tilt of the board. `image_quality` combines
them with the detection. `advice` evaluates all images so far. No lens is fitted here, so an answer
takes no longer than the detection.
"""
