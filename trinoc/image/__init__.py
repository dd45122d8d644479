"""A picture as light: grey levels, a camera's response, noise, clipping, and one blurred step; as a
camera without distortion would have taken it.

Between `geometry` and the rooms that read pictures. Whoever reads a picture begins with
`Light.from_picture`, or with `grey_image` where the scale of its own numbers is wanted."""
