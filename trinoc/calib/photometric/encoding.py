"""How the grey levels of a rig's pictures stand for light, as far as somebody says it.

A raw mosaic of colours becomes one grey picture, each pixel by itself, without interpolation: a
pixel behind a red filter sees paper and ink at other levels than one behind a green filter, and
the same edge. Levels are brought to those of green; the noise grows with them.
"""

from typing import Literal, NamedTuple, get_args

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.calib.photometric.sheet_places import circle_points_mm, project_to_image
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.image.response import PowerResponse, find_response

Response = Literal["linear", "srgb", "fit"]
# numerical: samples of flat parts of a circle's ink and of the paper round it, in radii.
_INK_RADII, _PAPER_RADII = (0.2, 0.4, 0.6), (1.3, 1.4, 1.5)
_NEUTRAL = np.array([0.25, 0.5, 0.25])  # numerical: equal weights of both pixels of a colour


class Encoding(NamedTuple):
    """What is known of the pictures beside their size.

    Fields
    ------
    bayer : for raw mosaics, colours of the first two pixels of the first two rows, such as "RGGB";
        None for pictures that are none.
    response : "linear" or "srgb" where the camera's response is known, else "fit": linear, until
        the edges' profiles refute it.
    """

    bayer: str | None = None
    response: Response = "fit"

    @property
    def bend(self) -> float | None:
        """Of the response (0 linear, 1 sRGB); None where it is to be fitted."""
        if self.response == "fit":
            return None
        known = find_response(self.response)
        assert isinstance(known, PowerResponse)
        return float(known.bend)

    def check(self) -> None:
        """Raise InputError for words that say nothing."""
        is_text = isinstance(self.bayer, str)
        if self.bayer is not None and not (is_text and sorted(self.bayer) == sorted("RGGB")):
            raise InputError(
                f'bayer is "{self.bayer}", but must be "RGGB", "BGGR", "GRBG" or "GBRG".'
            )
        if self.response not in get_args(Response):
            raise InputError(f'response is "{self.response}", but must be linear, srgb or fit.')


# Nothing is known.
AS_DELIVERED = Encoding()


class BalancedMosaic(NamedTuple):
    """Grey levels as if every pixel were green, and by how much their noise has grown."""

    image: Float[np.ndarray, "h w"]
    noise_scale: Float[np.ndarray, "h w"]


def balance_mosaic(
    image: Float[np.ndarray, "h w"],
    bayer: str,
    pose: Pose,
    lens: AbstractLens,
    pattern: Pattern,
    fewest_pixels: int,
) -> BalancedMosaic:
    """The mosaic with each colour's paper and ink at the levels of green.

    bayer : colours of the first two pixels of the first two rows, such as "RGGB".
    fewest_pixels : how many pixels of a colour a mean level needs.

    Raises InputError where too little of the sheet is seen.
    """
    phase = _phases(image.shape)
    # The two greens are one colour; the others are told by their place in the tile.
    colour = np.array([bayer.index(letter) for letter in bayer])[phase]
    full = pattern.inner_radius_mm == 0
    ink, paper = (
        _levels(
            image, colour, _samples(pattern, full, radii, pose, lens, image.shape), fewest_pixels
        )
        for radii in (_INK_RADII, _PAPER_RADII)
    )
    green = bayer.index("G")
    gain = np.ones(4)
    for one in set(colour.ravel().tolist()):
        gain[one] = (paper[green] - ink[green]) / max(paper[one] - ink[one], 1e-6)
    offset = ink[green] - gain * ink
    scale = gain[colour]
    return BalancedMosaic((image * scale + offset[colour]).astype(np.float32), scale)


def neutral_mosaic(image: Shaped[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Every pixel with a quarter of red, a half of green and a quarter of blue about it.

    The weights are alike on both sides, so that nothing is displaced. Raises InputError for a
    picture that is no mosaic.
    """
    if image.ndim != 2:
        raise InputError(
            f"A mosaic has one number a pixel, but the picture has shape {image.shape}: give the "
            "raw picture, or leave out bayer."
        )
    return cv2.sepFilter2D(image.astype(np.float32), -1, _NEUTRAL, _NEUTRAL)


def _phases(shape: tuple[int, ...]) -> Int[np.ndarray, "h w"]:
    row, column = np.indices(shape[:2]) % 2
    return 2 * row + column


def _samples(
    pattern: Pattern,
    full: np.ndarray,
    radii: tuple[float, ...],
    pose: Pose,
    lens: AbstractLens,
    shape: tuple[int, ...],
) -> Int[np.ndarray, "n 2"]:
    """(row, column) of pixels on rings about the full discs."""
    centres, radius = pattern.centres_mm[full], pattern.radius_mm[full]
    rings = [circle_points_mm(centres, share * radius).reshape(-1, 2) for share in radii]
    uv_px = np.asarray(project_to_image(pose, lens, np.concatenate(rings)))
    place = np.round(uv_px[:, ::-1]).astype(int)
    return np.unique(place[np.all((place >= 0) & (place < shape[:2]), axis=1)], axis=0)


def _levels(
    image: Float[np.ndarray, "h w"],
    colour: Int[np.ndarray, "h w"],
    place: Int[np.ndarray, "n 2"],
    fewest_pixels: int,
) -> Float[np.ndarray, "4"]:
    """Mean level of each colour at the samples, outliers apart."""
    levels, seen = np.zeros(4), image[tuple(place.T)]
    of_pixel = colour[tuple(place.T)]
    for one in set(colour.ravel().tolist()):
        values = seen[of_pixel == one].astype(np.float64)
        if len(values) < fewest_pixels:
            raise InputError(
                "Too little of the sheet is seen to balance the colours of a mosaic: "
                "interpolate it first."
            )
        middle = np.median(values)
        spread = np.median(np.abs(values - middle)) + 1.0
        levels[one] = np.mean(values[np.abs(values - middle) < 5 * spread])
    return levels
