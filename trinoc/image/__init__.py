"""Image as light: grey levels, camera response, noise, saturation, step edges, undistorted images.

Between `geometry` and the rooms that read images. Start with `Light.from_picture`, or with
`grey_image` to keep the scale of the image's own numbers.
"""
