"""A picture as light: grey levels, a camera's response, noise, clipping, and one blurred step.

Between `geometry` and the rooms that read pictures. Whoever reads a picture begins with
`Light.from_picture`, or with `grey_image` where the scale of its own numbers is wanted."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
