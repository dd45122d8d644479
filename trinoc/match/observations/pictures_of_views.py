"""What steps that go back to the pictures need of every view."""

from collections.abc import Mapping, Sequence

import numpy as np

from trinoc.errors import InputError, list_names
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.numerics.precision import ArrayLike


def as_segments(given: Segments | ArrayLike) -> Segments:
    """Segments, whether or not they were given as their ends alone."""
    return given if isinstance(given, Segments) else Segments.from_endpoints(given)


def segments_of_views(
    doing: str, views: Sequence[str], segments: Mapping[str, Segments | ArrayLike]
) -> dict[str, Segments]:
    """The segments of every view. Raises InputError where one has none; `doing` needs them."""
    _expect_all(doing, views, "segments", segments)
    return {name: as_segments(segments[name]) for name in views}


def check_pictures(
    doing: str, views: Sequence[str], rig: Rig, pictures: Mapping[str, np.ndarray]
) -> None:
    """Raise InputError for views without a picture, or a picture of another size.

    doing : what needs them, as a sentence begins.
    """
    _expect_all(doing, views, "picture", pictures)
    for name in views:
        width, height = rig[name].image_size_px
        shape = np.shape(pictures[name])[:2]
        if shape != (height, width):
            raise InputError(
                f'The picture of "{name}" has the shape {shape}, but its camera has {width} x '
                f"{height} px: give the picture that its segments were found in."
            )


def _expect_all(doing: str, views: Sequence[str], what: str, held: Mapping[str, object]) -> None:
    missing = [name for name in views if name not in held]
    if missing:
        raise InputError(
            f'{doing} needs the {what} of every view, but "{missing[0]}" has none: give what was '
            f"matched of {list_names(views)}."
        )
