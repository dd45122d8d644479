"""Fitted lenses that fold the image: a distortion that is not determined out to the corners."""

from collections.abc import Mapping

from trinoc.errors import CalibrationError
from trinoc.geometry.intrinsics import Intrinsics, describe_fold


def describe_folded_lens(lenses: Mapping[str, Intrinsics]) -> str | None:
    """Return a sentence on the first lens that folds its image, with the remedy; None without one.

    `lenses` are fitted lenses by the name of their camera. A distortion that fits the corners
    observed in the middle of the image may fold it farther out. Such a lens cannot be inverted
    there, and no file of it can be read.
    """
    for camera, lens in lenses.items():
        fold = describe_fold(lens)
        if fold is not None:
            return (
                f'The fitted distortion of "{camera}" {fold}: show the board nearer to the corners '
                "of the image, or fit fewer coefficients (distortion=1 or distortion=2)."
            )
    return None


def expect_unfolded(lenses: Mapping[str, Intrinsics]) -> None:
    """Raise CalibrationError if a fitted lens folds its image; see `describe_folded_lens`."""
    sentence = describe_folded_lens(lenses)
    if sentence is not None:
        raise CalibrationError(sentence)
