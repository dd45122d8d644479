"""Epipolar lines on the pictures: a handful of correspondences, and what a click needs."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from skimage.measure import find_contours

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.geometry.camera import Camera, project
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.numerics.buckets import bucket, pad_rows
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.programs import kept_jit
from trinoc.report.numbers import with_decimals
from trinoc.report.pictures import PagePicture
from trinoc.report.space_content import PALETTE

SHOWN = 6
# Rays of a bent picture are kept at so many places along each side: between them the curves are
# within a tenth of a pixel. A straight one needs its corners alone.
PLACES, PLACES_OF_STRAIGHT = 25, 2


class EpipolarCurve(NamedTuple):
    """Epipolar line in one image, which lens distortion bends.

    Attributes
    ----------
    points_px : (n, 2)
        Points of the curve.
    source : str
        Name of the view whose point determines the line.
    colour : str
        Colour of that point.
    dashed : bool
        True unless `source` is the first of the other views.
    """

    points_px: Float[np.ndarray, "n 2"]
    source: str
    colour: str
    dashed: bool


class Mark(NamedTuple):
    """Labelled point of one correspondence in one image.

    Attributes
    ----------
    label : str
        Label of the correspondence, equal in all views.
    u, v : float
        Position, px.
    colour : str
        Colour of the correspondence.
    """

    label: str
    u: float
    v: float
    colour: str


class EpipolarFigure(NamedTuple):
    """Figure of one image: its corresponding points, with the epipolar lines of the same points in
    the other views.
    """

    name: str
    picture: PagePicture
    marks: tuple[Mark, ...]
    curves: tuple[EpipolarCurve, ...]


class EpipolarPart(NamedTuple):
    """Section of the report with corresponding points and their epipolar lines.

    Attributes
    ----------
    key : str
        Identifier on the page.
    kind : str
        Kind of points, as text.
    figures : tuple of EpipolarFigure
        Figure of each view.
    count : int
        Number of correspondences that all views show.
    distances : tuple of (view, view, text)
        Rms distance from the epipolar lines, px, of each pair of views.
    largest_px : float
        Largest of these distances.
    cameras : list of dict
        Numbers from which the page's script draws the lines of any point that the reader clicks.
    """

    key: str
    kind: str
    figures: tuple[EpipolarFigure, ...]
    count: int
    distances: tuple[tuple[str, str, str], ...]
    largest_px: float
    cameras: list[dict[str, Any]]


def corrected_circle_centres(result: CalibrationResult) -> Float[np.ndarray, "n v 2"]:
    """Images of the circles' centres, (n, v, 2) px: ellipse centres, corrected for perspective.

    Only the images of the centres correspond between views; the ellipse centres do not. NaN if a
    view does not show a circle.
    """
    pattern, rig = result.pattern, result.rig
    points = np.full((len(pattern), len(rig), 2), np.nan)
    for view, (name, camera) in enumerate(rig.items()):
        shift = shift_of_circle_centres(camera, pattern.centres_mm, pattern.radius_mm)
        detection, used = result.fits[name].detection, np.asarray(result.fits[name].used)
        index = detection.circle_index[used]
        points[index, view] = detection.centres_px[used] + shift[index]
    return points


def ends_of_tracks(matches: Matches) -> Float[np.ndarray, "n v 2"]:
    """Corresponding ends of fragments, (n, v, 2) px, of the tracks in three or more views."""
    fragments = np.asarray(matches.fragments_px)[np.asarray(matches.stage) == TRINOCULAR]
    return np.concatenate([fragments[:, :, 0], fragments[:, :, 1]])


def epipolar_part(
    key: str,
    kind: str,
    rig: Rig,
    points_px: Float[np.ndarray, "n v 2"],
    pictures: Mapping[str, PagePicture],
) -> EpipolarPart | None:
    """Section with some of the corresponding points, and their epipolar lines in the other views.

    Returns None with fewer than three points that all views show.

    key : identifier on the page.
    kind : kind of the points, as text.
    points_px : (n, v, 2) corresponding points, NaN if a view does not show a point.
    pictures : images by view.
    """
    common_points = points_px[np.isfinite(points_px).all(axis=(1, 2))]
    if len(common_points) < 3 or len(rig) < 2:
        return None
    shown_rows = _spread(common_points, SHOWN)
    grids = {name: _rays_over(camera) for name, camera in rig.items()}
    figures = []
    for view, (name, camera) in enumerate(rig.items()):
        marks = tuple(
            Mark(str(number + 1), float(u), float(v), PALETTE[number % len(PALETTE)])
            for number, (u, v) in enumerate(common_points[shown_rows, view])
        )
        curves = []
        for order, other in enumerate(v for v in range(len(rig)) if v != view):
            planes = epipolar_planes(camera, rig.cameras[other], common_points[shown_rows, other])
            for plane, mark in zip(planes, marks, strict=True):
                curve = _curve(grids[name], plane, camera.image_size_px)
                if curve is not None:
                    curves.append(EpipolarCurve(curve, rig.names[other], mark.colour, order > 0))
        figures.append(EpipolarFigure(name, pictures[name], marks, tuple(curves)))
    distances = {
        (first, second): _rms_distance_px(rig[first], rig[second], common_points[:, [a, b]])
        for a, first in enumerate(rig)
        for b, second in enumerate(rig)
        if a < b
    }
    return EpipolarPart(
        key,
        kind,
        tuple(figures),
        len(common_points),
        tuple((*pair, with_decimals(distance, 3)) for pair, distance in distances.items()),
        max(distances.values()),
        [_numbers(rig, name, grids[name]) for name in rig],
    )


def _spread(points: Float[np.ndarray, "n v 2"], count: int) -> list[int]:
    """Rows of up to `count` points that are far apart in the first view.

    Each further point is the one that is farthest from the points already chosen.
    """
    first = points[:, 0]
    rows = [int(np.argmin(first.sum(axis=1)))]
    nearest_px = np.full(len(points), np.inf)
    while len(rows) < min(count, len(points)):
        nearest_px = np.minimum(nearest_px, np.linalg.norm(first - first[rows[-1]], axis=1))
        rows.append(int(np.argmax(nearest_px)))
    return rows


def _rays_over(camera: Camera) -> Float[np.ndarray, "r c 3"]:
    """Rays in the camera frame through a grid of r x c pixels that spans the image, (r, c, 3).

    They are scaled to (x/z, y/z, 1) if all of them point forward.
    """
    count = PLACES if camera.intrinsics.has_distortion else PLACES_OF_STRAIGHT
    width, height = camera.image_size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, count), np.linspace(0, height - 1, count))
    rays = rays_of_pixels(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    if (rays[:, 2] > 0.1).all():
        rays = rays / rays[:, 2:]
    return rays.reshape(count, count, 3)


def _curve(
    rays: Float[np.ndarray, "r c 3"], plane: Float[np.ndarray, "3"], size_px: tuple[int, int]
) -> Float[np.ndarray, "n 2"] | None:
    """Points (n, 2) px of an epipolar curve; None if the curve does not cross the image.

    rays : rays of a grid of pixels that spans the image. plane : normal of the epipolar plane.
    """
    contours = find_contours(rays @ plane, 0.0)
    if not contours:
        return None
    contour = max(
        contours, key=lambda part: float(np.linalg.norm(np.diff(part, axis=0), axis=1).sum())
    )
    # Rows and columns of the grid.
    return contour[:, ::-1] * (np.array(size_px) - 1) / (np.array(rays.shape[1::-1]) - 1)


def _rms_distance_px(a: Camera, b: Camera, points: Float[np.ndarray, "n 2 2"]) -> float:
    distances = epipolar_distances_px(b, a, points[:, 1], points[:, 0])
    return float(np.sqrt(np.mean(distances**2)))


def _numbers(rig: Rig, name: str, rays: Float[np.ndarray, "r c 3"]) -> dict[str, Any]:
    """Numbers from which the page's script draws epipolar lines into this view.

    rays : rays of a grid of pixels that spans the image.
    """
    camera = rig[name]
    return {
        "size": list(camera.image_size_px),
        "places": len(rays),
        "rays": np.round(rays, 6).ravel().tolist(),
        "rotation": np.asarray(camera.pose.rotation).tolist(),
        "centre": np.asarray(camera.centre_world_mm).tolist(),
    }


@in_float64
def rays_of_pixels(camera: Camera, uv_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Unit rays of pixels in the camera frame, (n, 3), for any lens model."""
    return np.asarray(_rays(camera, _in_bucket(uv_px)))[: len(uv_px)]


@in_float64
def epipolar_planes(
    camera_b: Camera, camera_a: Camera, uv_a_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Unit normals of epipolar planes in the frame of camera b, (n, 3).

    Each plane contains both camera centres and the ray of a pixel of camera a. A pixel of camera b
    lies on the epipolar curve if its ray is perpendicular to the normal.
    """
    return np.asarray(_planes(camera_b, camera_a, _in_bucket(uv_a_px)))[: len(uv_a_px)]


@in_float64
def epipolar_distances_px(
    camera_b: Camera,
    camera_a: Camera,
    uv_b_px: Float[np.ndarray, "n 2"],
    uv_a_px: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n"]:
    """Distance of points in view b from the epipolar curves of the corresponding points in view a,
    px.
    """
    distances = _distances_px(camera_b, camera_a, _in_bucket(uv_b_px), _in_bucket(uv_a_px))
    return np.asarray(distances)[: len(uv_b_px)]


@in_float64
def shift_of_circle_centres(
    camera: Camera, centres_mm: Float[np.ndarray, "n 2"], radius_mm: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 2"]:
    """Shift from the centre of each circle's elliptical image to the image of the circle's centre,
    px.

    centres_mm, radius_mm : the circles on the sheet Z = 0.
    """
    return np.asarray(_centre_shifts(camera, centres_mm, radius_mm))


def _in_bucket(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    return pad_rows(points, bucket(len(points)), points[-1] if len(points) else 0)


@kept_jit
def _rays(camera: Camera, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 3"]:
    return jax.vmap(camera.intrinsics.lens.unproject)(uv_px)


@kept_jit
def _planes(
    camera_b: Camera, camera_a: Camera, uv_a_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    to_centre = camera_b.pose.rotation @ (
        camera_a.pose.centre_world_mm - camera_b.pose.centre_world_mm
    )
    turn = camera_b.pose.rotation @ camera_a.pose.rotation.T

    def normal(uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        across = jnp.cross(to_centre, turn @ camera_a.intrinsics.lens.unproject(uv_px))
        return across / jnp.linalg.norm(across)

    return jax.vmap(normal)(uv_a_px)


@kept_jit
def _distances_px(
    camera_b: Camera,
    camera_a: Camera,
    uv_b_px: Float[ArrayLike, "n 2"],
    uv_a_px: Float[ArrayLike, "n 2"],
) -> Float[ArrayLike, "n"]:
    def distance(
        normal: Float[ArrayLike, "3"], uv_px: Float[ArrayLike, "2"]
    ) -> Float[ArrayLike, ""]:
        off, slope = jax.value_and_grad(lambda uv: normal @ camera_b.intrinsics.lens.unproject(uv))(
            uv_px
        )
        return jnp.abs(off) / jnp.linalg.norm(slope)

    return jax.vmap(distance)(_planes(camera_b, camera_a, uv_a_px), uv_b_px)


@kept_jit
def _centre_shifts(
    camera: Camera, centres_mm: Float[ArrayLike, "n 2"], radius_mm: Float[ArrayLike, "n"]
) -> Float[ArrayLike, "n 2"]:
    def shift(
        centre_mm: Float[ArrayLike, "2"], radius: Float[ArrayLike, ""]
    ) -> Float[ArrayLike, "2"]:
        image_of_centre = project(camera, jnp.append(centre_mm, 0.0))
        return image_of_centre - image_of_circle_centre(camera, centre_mm, radius)

    return jax.vmap(shift)(centres_mm, radius_mm)
