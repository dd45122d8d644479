"""Which picture to take next: the one that teaches most about what is known worst."""

from functools import partial
from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.intrinsics.advice import NextImage
from trinoc.calib.intrinsics.lens_information import directions_of, lens_information
from trinoc.calib.intrinsics.lens_parameters import LensModel
from trinoc.calib.intrinsics.lens_residual import information_of_images, residuals_px
from trinoc.calib.model import CircleObservations
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens
from trinoc.numerics import as_numpy

_TILT_RAD = np.radians(40.0)
# Share of the picture's shorter side that the sheet takes.
_COMFORTABLE, _NEAR, _SMALL = 0.65, 1.0, 0.45
# Circles nearer to the border than this many of their radii would be cut.
_MARGIN_RADII = 1.2
_FEWEST_CIRCLES = 6
# Advice must be possible where nothing is determined: each scaled parameter is taken to be known
# to this factor beforehand. No covariance that leaves this module contains it.
_PRIOR_SIGMA = 3.0


class View(NamedTuple):
    """A way to hold the sheet, in words and as a pose."""

    words: str
    cam_from_world: Float[np.ndarray, "3 4"]


def next_image(
    lens: AbstractLens,
    scale: Float[np.ndarray, "q"],
    information: Float[np.ndarray, "q q"],
    determined: Bool[np.ndarray, "q"],
    model: LensModel,
    pattern: Pattern,
    image_size_px: tuple[int, int],
    sigma_px: float,
) -> NextImage | None:
    """The generic view that lowers the largest sigma most.

    information : of the pictures taken, on the parameters of the lens in units of `scale`.
    determined : which of these the pictures determine.
    sigma_px : of a circle's centre.

    Sigmas are compared in units of `scale`, in which they mean displacements of the corners.
    None where no view would help.
    """
    views = generic_views(lens, pattern, image_size_px)
    circles = _circles_in_view(lens, views, pattern, image_size_px, sigma_px)
    poses = np.stack([view.cam_from_world for view in views])
    gains = lens_information(as_numpy(_information(lens, scale, poses, circles)))
    directions = directions_of(model)
    columns = [int(np.argmax(direction)) for direction in directions.T]
    variance_now = _variances(directions.T @ information @ directions)
    worst = int(np.argmax(variance_now))
    variance_then = [
        _variances(directions.T @ (information + gain) @ directions)[worst] for gain in gains
    ]
    best = int(np.argmin(variance_then))
    if not variance_then[best] < variance_now[worst]:
        return None
    column = columns[worst]
    known = bool(determined[column])
    return NextImage(
        words=views[best].words,
        cam_from_world=views[best].cam_from_world,
        parameter=model.free[worst],
        sigma_now=float(scale[column] * np.sqrt(variance_now[worst])) if known else np.inf,
        sigma_then=float(scale[column] * np.sqrt(variance_then[best])),
    )


def _variances(information: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q"]:
    values, vectors = np.linalg.eigh(information)
    return np.sum(vectors**2 / (np.maximum(values, 0.0) + _PRIOR_SIGMA**-2.0), axis=1)


def generic_views(
    lens: AbstractLens, pattern: Pattern, image_size_px: tuple[int, int]
) -> list[View]:
    """Ways to hold the sheet that anybody can follow."""
    place = partial(_view, lens, pattern, image_size_px)
    sides = {"left": (0.0, -1.0), "right": (0.0, 1.0), "upper": (1.0, 0.0), "lower": (-1.0, 0.0)}
    corners = {
        "upper left": (0.27, 0.27),
        "upper right": (0.73, 0.27),
        "lower left": (0.27, 0.73),
        "lower right": (0.73, 0.73),
    }
    views = []
    for side, (about_x, about_y) in sides.items():
        turn = _TILT_RAD * np.array([about_x, about_y, 0.0])
        tilt = f"tilt the sheet by 40 degrees, its {side} side toward the camera"
        views.append(place(f"{tilt}, in the middle of the picture", turn))
        views.append(place(f"{tilt}, so near that it fills the picture", turn, fill=_NEAR))
        views.append(place(f"{tilt}, rolled by 90 degrees", turn, roll=np.pi / 2))
    views.append(place("hold the sheet square to the camera, filling the picture", fill=_NEAR))
    for corner, middle in corners.items():
        words = f"hold the sheet square to the camera, in the {corner} corner of the picture"
        views.append(place(words, fill=_SMALL, middle=middle))
        sign = np.sign(np.array(middle) - 0.5)
        # Turned about the other diagonal, so that the sheet's far side is the picture's corner.
        turn = _TILT_RAD * np.array([sign[1], -sign[0], 0.0]) / np.sqrt(2.0)
        words = (
            f"tilt the sheet by 40 degrees in the {corner} corner of the picture, that corner away"
        )
        views.append(place(words, turn, fill=_SMALL, middle=middle))
    return views


def _view(
    lens: AbstractLens,
    pattern: Pattern,
    image_size_px: tuple[int, int],
    words: str,
    turn: Float[np.ndarray, "3"] | None = None,
    *,
    roll: float = 0.0,
    fill: float = _COMFORTABLE,
    middle: tuple[float, float] = (0.5, 0.5),
) -> View:
    """The sheet facing the camera, then rolled, then turned about the picture's axes."""
    facing = np.diag([1.0, -1.0, -1.0])
    turn = np.zeros(3) if turn is None else turn
    rolled = cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    rotation = cv2.Rodrigues(turn)[0] @ rolled @ facing
    # Measured with the pixels of each axis, so that lenses with oblong pixels are served, too.
    extent_mm = np.max(np.ptp(pattern.centres_mm, axis=0) + 2.0 * pattern.radius_mm.max())
    distance = np.max(lens.focal_length_px * extent_mm / (fill * np.array(image_size_px)))
    centre_mm = np.append(0.5 * (pattern.centres_mm.min(0) + pattern.centres_mm.max(0)), 0.0)
    uv_px = np.array(middle) * (np.array(image_size_px) - 1.0)
    ray = np.append((uv_px - lens.principal_point_px) / lens.focal_length_px, 1.0)
    translation = distance * ray - rotation @ centre_mm
    return View(words, np.concatenate([rotation, translation[:, None]], axis=1))


_information = jax.jit(information_of_images)
_residuals_px = jax.jit(residuals_px)


def _circles_in_view(
    lens: AbstractLens,
    views: list[View],
    pattern: Pattern,
    image_size_px: tuple[int, int],
    sigma_px: float,
) -> CircleObservations:
    """The circles that each view would show, at the accuracy of those already seen."""
    poses = np.stack([view.cam_from_world for view in views])
    count, size = len(views), len(pattern)
    everything = CircleObservations(
        np.broadcast_to(pattern.centres_mm, (count, size, 2)),
        np.broadcast_to(pattern.radius_mm, (count, size)),
        np.zeros((count, size, 2)),
        np.zeros((count, size, 2, 2)),
        np.zeros((count, 2, 3)),
    )
    centres_px = as_numpy(_residuals_px(lens, poses, everything))
    depth = poses[:, None, 2, 3] + np.einsum("ki,ni->kn", poses[:, 2, :2], pattern.centres_mm)
    margin = _MARGIN_RADII * pattern.radius_mm[None] / depth * np.max(lens.focal_length_px)
    inside = (centres_px > margin[..., None]) & (
        centres_px < np.array(image_size_px) - 1.0 - margin[..., None]
    )
    seen = inside.all(axis=2) & (depth > 0.0)
    seen &= seen.sum(axis=1, keepdims=True) >= _FEWEST_CIRCLES
    whitening = np.where(seen[..., None, None], np.eye(2) / sigma_px, 0.0)
    return everything._replace(whitening=whitening)
