"""Pictures and segments that are those of a rig's cameras."""

import os

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments


def expect_inside(name: str, segments: Segments, rig: Rig, file: str | os.PathLike[str]) -> None:
    """Raise InputError for segments more than a picture's width beyond the picture."""
    size = np.array(rig[name].image_size_px)
    ends = np.asarray(segments.endpoints_px)
    outside = np.flatnonzero(((ends < -size) | (ends > 2 * size)).any(axis=(1, 2)))
    if len(outside):
        raise InputError(
            f'{file}: segment {outside[0]} lies far outside the pictures of "{name}", which are '
            f"{size[0]} x {size[1]} px: give ends in pixels of that camera."
        )


def expect_size(name: str, image: np.ndarray, rig: Rig) -> None:
    """Raise InputError where a picture has not the size that the rig was calibrated for."""
    size = (image.shape[1], image.shape[0])
    if size != rig[name].image_size_px:
        raise InputError(
            f'The picture of "{name}" is {size[0]} x {size[1]} px, but the rig was calibrated for '
            f"{rig[name].image_size_px[0]} x {rig[name].image_size_px[1]} px: give a picture of "
            "that size."
        )
