"""What steps that go back to the pictures need of every view."""

from collections.abc import Mapping, Sequence

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry import Rig, Segments
from trinoc.numerics import ArrayLike


def as_segments(given: Segments | ArrayLike) -> Segments:
    """Segments, whether or not they were given as their ends alone."""
    return given if isinstance(given, Segments) else Segments.from_endpoints(given)


def check_pictures(
    doing: str,
    views: Sequence[str],
    segments: Mapping[str, object],
    rig: Rig,
    pictures: Mapping[str, np.ndarray],
) -> None:
    """Raise InputError for views without a picture or segments, or a picture of another size.

    doing : what needs them, as a sentence begins.
    """
    for name in views:
        for what, held in (("picture", pictures), ("segments", segments)):
            if name not in held:
                raise InputError(
                    f'{doing} needs the {what} of every view, but "{name}" has none: '
                    f"give what was matched of {', '.join(views)}."
                )
        width, height = rig[name].image_size_px
        shape = np.shape(pictures[name])[:2]
        if shape != (height, width):
            raise InputError(
                f'The picture of "{name}" has the shape {shape}, but its camera has {width} x '
                f"{height} px: give the picture that its segments were found in."
            )
