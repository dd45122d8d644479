"""Known relation of grey levels to light: camera response, and raw colour mosaics.

A raw colour mosaic becomes one grey image without interpolation. A pixel with a red filter has
other levels of paper and ink than one with a green filter, but the same edge. Its levels are
scaled to those of green; the noise is scaled as well.
"""

from typing import Literal, NamedTuple, get_args

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.calib.photometric.sheet_geometry import circle_points_mm, project_to_image
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.image.response import PowerResponse, find_response

Response = Literal["linear", "srgb", "fit"]
# numerical: radii of sample points in a circle's ink and in the paper around it, in its radii.
_INK_RADII, _PAPER_RADII = (0.2, 0.4, 0.6), (1.3, 1.4, 1.5)
_NEUTRAL = np.array([0.25, 0.5, 0.25])  # numerical: equal total weights of even and odd pixels


class Encoding(NamedTuple):
    """Known properties of the images of a rig: Bayer pattern and camera response.

    Attributes
    ----------
    bayer : colours of the first two pixels of the first two rows of a raw colour mosaic, such as
        "RGGB"; None for other images.
    response : "linear" or "srgb" if the camera's response is known. "fit": the response is assumed
        linear, and it is estimated if the profiles of edges contradict this.
    """

    bayer: str | None = None
    response: Response = "fit"

    @property
    def response_bend(self) -> float | None:
        """Curvature of the known response (0 linear, 1 sRGB); None if the response is estimated."""
        if self.response == "fit":
            return None
        response = find_response(self.response)
        assert isinstance(response, PowerResponse)
        return float(response.bend)

    def check(self) -> None:
        """Raise `InputError` if `bayer` or `response` has an unknown value."""
        is_text = isinstance(self.bayer, str)
        if self.bayer is not None and not (is_text and sorted(self.bayer) == sorted("RGGB")):
            raise InputError(f'bayer is "{self.bayer}": give "RGGB", "BGGR", "GRBG" or "GBRG".')
        if self.response not in get_args(Response):
            raise InputError(f'response is "{self.response}": give linear, srgb or fit.')


# Default: no known response, no mosaic.
AS_DELIVERED = Encoding()


class BalancedMosaic(NamedTuple):
    """A raw mosaic in which paper and ink have the same grey levels under all colour filters.

    Attributes
    ----------
    image : (h, w) grey levels, scaled to the levels of green pixels.
    noise_scale : (h, w) factor by which the scaling multiplies the noise.
    """

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
    """Scale each colour of a mosaic so that paper and ink have the levels of green pixels.

    Parameters
    ----------
    image : raw mosaic.
    bayer : colours of the first two pixels of the first two rows, such as "RGGB".
    pose, lens : approximate camera, used to find pixels of ink and of paper.
    pattern : the sheet.
    fewest_pixels : smallest number of pixels from which the mean level of a colour is computed.

    Raises
    ------
    InputError : too little of the sheet is visible.
    """
    phase = _phases(image.shape)
    # Both green pixels of a tile have the same colour index.
    colour = np.array([bayer.index(letter) for letter in bayer])[phase]
    is_disc = pattern.inner_radius_mm == 0
    ink, paper = (
        _levels(
            image, colour, _samples(pattern, is_disc, radii, pose, lens, image.shape), fewest_pixels
        )
        for radii in (_INK_RADII, _PAPER_RADII)
    )
    green = bayer.index("G")
    gain = np.ones(4)
    for k in set(colour.ravel().tolist()):
        gain[k] = (paper[green] - ink[green]) / max(paper[k] - ink[k], 1e-6)
    offset = ink[green] - gain * ink
    scale = gain[colour]
    return BalancedMosaic((image * scale + offset[colour]).astype(np.float32), scale)


def neutral_mosaic(image: Shaped[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Convert a raw mosaic to a grey image: 1/4 red, 1/2 green and 1/4 blue in every pixel.

    The filter is symmetric and does not displace edges.

    Raises
    ------
    InputError : the image has more than one value per pixel.
    """
    if image.ndim != 2:
        raise InputError(
            f"A mosaic has one number per pixel, but the image has the shape {image.shape}: give "
            "the raw image, or omit bayer."
        )
    return cv2.sepFilter2D(image.astype(np.float32), -1, _NEUTRAL, _NEUTRAL)


def _phases(shape: tuple[int, ...]) -> Int[np.ndarray, "h w"]:
    """Position of each pixel in its 2 x 2 tile of the mosaic: 0 to 3, row by row."""
    row, column = np.indices(shape[:2]) % 2
    return 2 * row + column


def _samples(
    pattern: Pattern,
    is_disc: np.ndarray,
    radii: tuple[float, ...],
    pose: Pose,
    lens: AbstractLens,
    shape: tuple[int, ...],
) -> Int[np.ndarray, "n 2"]:
    """Pixels (row, column) on rings around the centres of the discs, inside the image.

    is_disc : mask of the pattern's circles that are discs, not rings.
    radii : radii of the rings divided by the radius of the disc.
    shape : rows and columns of the image.
    """
    centres, radius = pattern.centres_mm[is_disc], pattern.radius_mm[is_disc]
    rings = [circle_points_mm(centres, share * radius).reshape(-1, 2) for share in radii]
    uv_px = np.asarray(project_to_image(pose, lens, np.concatenate(rings)))
    pixels = np.round(uv_px[:, ::-1]).astype(int)
    inside = np.all((pixels >= 0) & (pixels < shape[:2]), axis=1)
    return np.unique(pixels[inside], axis=0)


def _levels(
    image: Float[np.ndarray, "h w"],
    colour: Int[np.ndarray, "h w"],
    pixels: Int[np.ndarray, "n 2"],
    fewest_pixels: int,
) -> Float[np.ndarray, "4"]:
    """Mean grey level of each colour index (0 to 3), without outliers.

    colour : (h, w) colour index of each pixel.
    pixels : (n, 2) sample pixels (row, column).
    """
    levels, grey = np.zeros(4), image[tuple(pixels.T)]
    colour_of_pixel = colour[tuple(pixels.T)]
    for k in set(colour.ravel().tolist()):
        values = grey[colour_of_pixel == k].astype(np.float64)
        if len(values) < fewest_pixels:
            raise InputError(
                f"A colour of the mosaic has only {len(values)} pixels on the sheet, and "
                f"{fewest_pixels} are needed to balance the colours: interpolate the mosaic first."
            )
        middle = np.median(values)
        spread = np.median(np.abs(values - middle)) + 1.0
        levels[k] = np.mean(values[np.abs(values - middle) < 5 * spread])
    return levels
