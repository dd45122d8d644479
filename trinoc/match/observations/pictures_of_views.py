"""Check the images and segments of all views, for steps that use the images again."""

from collections.abc import Mapping, Sequence

import numpy as np

from trinoc.errors import InputError, list_names
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.numerics.precision import ArrayLike


def as_segments(segments: Segments | ArrayLike) -> Segments:
    """Convert an array of segment ends to `Segments`; return `Segments` unchanged."""
    return segments if isinstance(segments, Segments) else Segments.from_endpoints(segments)


def segments_of_views(
    task: str, views: Sequence[str], segments: Mapping[str, Segments | ArrayLike]
) -> dict[str, Segments]:
    """Return the segments of every view. Raise `InputError` if a view has no segments.

    `task` is the name of the task, with which the error message begins.
    """
    _expect_all(task, views, "segments", segments)
    return {name: as_segments(segments[name]) for name in views}


def check_pictures(
    task: str, views: Sequence[str], rig: Rig, pictures: Mapping[str, np.ndarray]
) -> None:
    """Raise `InputError` if a view has no image, or an image of another size than its camera.

    `task` is the name of the task, with which the error message begins.
    """
    _expect_all(task, views, "image", pictures)
    for name in views:
        width, height = rig[name].image_size_px
        shape = np.shape(pictures[name])[:2]
        if shape != (height, width):
            raise InputError(
                f'The image of "{name}" has the shape {shape}, but its camera has {width} x '
                f"{height} px: give the image that its segments were detected in."
            )


def _expect_all(task: str, views: Sequence[str], kind: str, values: Mapping[str, object]) -> None:
    missing = [name for name in views if name not in values]
    if missing:
        raise InputError(
            f'{task} needs the {kind} of every view, but "{missing[0]}" has none: pass those '
            f"of {list_names(views)}."
        )
