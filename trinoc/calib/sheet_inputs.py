"""Checks of the user's inputs for calibration over one sheet."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trinoc.calib.targets.pattern import A_PATTERN, Pattern
from trinoc.errors import InputError, check_kind
from trinoc.geometry.intrinsics import A_LENS, Intrinsics
from trinoc.geometry.rig import check_camera_names
from trinoc.numerics.precision import ArrayLike


def check_images(images: Any, pattern: object) -> None:
    """Raise `InputError` for common mistakes in a first call, such as an image file that was not
    read.
    """
    check_kind(pattern, Pattern, "pattern", A_PATTERN)
    expected = 'a dictionary of each camera\'s name and image, such as {"left": image}'
    check_kind(images, Mapping, "set of images", expected)
    check_camera_names(images)
    for name, image in images.items():
        if image is None or np.ndim(image) not in (2, 3):
            actual = "None" if image is None else f"a {type(image).__name__}"
            raise InputError(
                f'The image of camera "{name}" is {actual}, but must be an array with height and '
                "width: check that its file was found and read."
            )


def check_image_sizes(images: Mapping[str, ArrayLike], lenses: Mapping[str, Intrinsics]) -> None:
    """Raise `InputError` if an image and its lens differ in size, or if two cameras have the same
    image.
    """
    names = list(images)
    for name in names:
        size, lens_size = np.shape(images[name])[1::-1], lenses[name].image_size_px
        if size != lens_size:
            raise InputError(
                f'The image of camera "{name}" has {_text(size)} pixels, but its lens is for '
                f"{_text(lens_size)}: give the intrinsics of this camera at this resolution."
            )
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            if np.array_equal(images[first], images[second]):
                raise InputError(
                    f'The same image was given for cameras "{first}" and "{second}": give each '
                    "camera its own image."
                )


def _text(size: tuple[int, ...]) -> str:
    return " x ".join(str(side) for side in size)


def lens_of_each(
    lens: Intrinsics | Mapping[str, Intrinsics], names: Mapping[str, object]
) -> dict[str, Intrinsics]:
    """Intrinsics of every camera, from one lens for all or from a mapping by name.

    Raises `InputError` if the lens of a camera is missing.

    names : images by the name of the camera; only the names are used.
    """
    if not names:
        raise InputError("No image was given: give one for each camera, by name.")
    if isinstance(lens, Intrinsics):
        return dict.fromkeys(names, lens)
    check_kind(lens, Mapping, "lens", f"{A_LENS}, or a dictionary of each camera's")
    missing = [name for name in names if name not in lens]
    if missing:
        raise InputError(
            f'There is no lens for camera "{missing[0]}": give one Intrinsics for all cameras, '
            "or one for each by name."
        )
    return {name: lens[name] for name in names}
