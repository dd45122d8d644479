"""Circles in space, how far the segments of pictures are off them, and least squares of one."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import homogeneous_pixel, pixel_change, project_by_matrix
from trinoc.geometry.rig import Rig
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, misfit_factor
from trinoc.numerics.vectors import complete_axes, cross_3d, vector3

# numerical: where a chord, fitted to the points of an arc, lies on it: the places of Gauss, as
# shares of its half length. What noise moves one of them by tells nothing of the other.
GAUSS = 1 / np.sqrt(3)
# numerical: places along a chord: both of these, its middle, its ends.
_PLACES = np.array([-GAUSS, GAUSS, 0.0, -1.0, 1.0])
# numerical: columns of `_PLACES`.
ON_ARC, MIDDLE, ENDS = slice(0, 2), 2, slice(3, 5)
# numerical: a column of `_PLACES`.
_BUT_ENDS = 3
# numerical: points round a circle that tell the axes of its image.
_AROUND = 8


def usual_mm_per_px(
    lines_mm: Float[np.ndarray, "t 2 3"], rig: Rig, views: tuple[str, ...]
) -> float:
    """Usual size of a pixel at the lines; 1 where there are none."""
    length = np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1)
    shares = []
    for name in views:
        image = project_by_matrix(np.asarray(rig[name].matrix_px), lines_mm)
        shares.append(length / np.linalg.norm(image[:, 1] - image[:, 0], axis=1))
    return float(np.median(shares)) if len(lines_mm) else 1.0


class Circles(NamedTuple):
    """centre_mm : (h, 3). normal : (h, 3) unit vectors across their planes. radius_mm : (h,)."""

    centre_mm: Float[np.ndarray, "h 3"]
    normal: Float[np.ndarray, "h 3"]
    radius_mm: Float[np.ndarray, "h"]


class Chords(NamedTuple):
    """Segments of all views in one table.

    view : in the order of the matches. segment : the caller's number. places_px : (n, 5, 2)
    undistorted, see `ON_ARC`, `MIDDLE` and `ENDS`. rays : (n, 5, 3) of them. centre_mm, matrix_px :
    of the camera. sigma_px : of each of the first two places, across. length_px : of each.
    """

    view: Int[np.ndarray, "n"]
    segment: Int[np.ndarray, "n"]
    places_px: Float[np.ndarray, "n k 2"]
    rays: Float[np.ndarray, "n k 3"]
    centre_mm: Float[np.ndarray, "n 3"]
    matrix_px: Float[np.ndarray, "n 3 4"]
    sigma_px: Float[np.ndarray, "n"]
    length_px: Float[np.ndarray, "n"]


class Off(NamedTuple):
    """Of chords s from circles h.

    px : (h, s, k) how far each place is outside the circle's image. cosine : (h, s) of the angle
    between chord and tangent. axis_ratio : (h, s) shorter over longer axis of the circle's image in
    the chord's view. around_mm : (h, s, k, 3) the circle's points next to the places.
    """

    px: Float[np.ndarray, "h s k"]
    cosine: Float[np.ndarray, "h s"]
    axis_ratio: Float[np.ndarray, "h s"]
    around_mm: Float[np.ndarray, "h s k 3"]


def collect_chords(seen: MatchInput, views: tuple[str, ...]) -> Chords:
    """All segments of all views."""
    parts = []
    for number, name in enumerate(views):
        view = seen.names.index(name)
        matrix = np.asarray(seen.frames[0].cameras.matrix_px)[view]
        ends, covariance = seen.ends_px[view], seen.covariance_px2[view]
        half = (ends[:, 1] - ends[:, 0]) / 2
        length = 2 * np.linalg.norm(half, axis=1)
        places = ends.mean(axis=1)[:, None] + _PLACES[:, None] * half[:, None]
        inverse = np.linalg.inv(matrix[:, :3])
        rays = np.concatenate([places, np.ones((len(ends), len(_PLACES), 1))], axis=2) @ inverse.T
        right = np.stack([-half[:, 1], half[:, 0]], axis=1) / (length / 2)[:, None]
        blocks = covariance.reshape(-1, 2, 2, 2, 2)
        of_ends = np.einsum("neiej,ni,nj->ne", blocks, right, right).mean(axis=1)
        parts.append(
            Chords(
                np.full(len(ends), number),
                seen.order[view],
                places,
                rays / np.linalg.norm(rays, axis=2, keepdims=True),
                np.tile(-inverse @ matrix[:, 3], (len(ends), 1)),
                np.tile(matrix, (len(ends), 1, 1)),
                # The ends of a line through many points have twice the variance.
                np.sqrt(of_ends / 2),
                length,
            )
        )
    return Chords(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def off_circles(chords: Chords, circles: Circles, *, with_ends: bool = False) -> Off:
    """How far chords are off circles, at three places of each or, with the ends, at all five."""
    centre, normal, radius = circles
    unit = (chords.places_px[:, 4] - chords.places_px[:, 3]) / chords.length_px[:, None]
    if not with_ends:
        places, rays = chords.places_px[:, :_BUT_ENDS], chords.rays[:, :_BUT_ENDS]
        chords = chords._replace(places_px=places, rays=rays)
    to_plane = (normal * centre).sum(axis=1)[:, None] - normal @ chords.centre_mm.T
    toward = (normal @ chords.rays.reshape(-1, 3).T).reshape(len(normal), *chords.rays.shape[:2])
    depth = to_plane[..., None] / np.where(np.abs(toward) > 1e-9, toward, 1e-9)
    out = chords.centre_mm[:, None] + depth[..., None] * chords.rays - centre[:, None, None]
    distance = np.linalg.norm(out, axis=3)
    radial = out / np.maximum(distance, 1e-12)[..., None]
    around = centre[:, None, None] + radius[:, None, None, None] * radial
    tangent = cross_3d(normal[:, None, None], radial)
    image, way = np.empty_like(around), np.empty_like(around[..., :2])
    ratio = np.zeros(distance.shape[:2])
    for view in np.unique(chords.view).tolist():
        own = chords.view == view
        matrix = chords.matrix_px[own.argmax()]
        image[:, own] = here = homogeneous_pixel(matrix, around[:, own])
        uv, along = vector3(here)[:2] / here[..., 2], vector3(tangent[:, own] @ matrix[:, :3].T)
        way[:, own] = np.stack(pixel_change((uv[0], uv[1]), here[..., 2], along), axis=-1)
        ratio[:, own] = image_circles(circles, matrix).axis_ratio[:, None]
    uv, behind = image[..., :2] / image[..., 2:], image[..., 2] <= 0
    way = way / np.maximum(np.linalg.norm(way, axis=3, keepdims=True), 1e-12)
    gap = chords.places_px - uv
    across = np.abs(gap[..., 0] * way[..., 1] - gap[..., 1] * way[..., 0])
    across = np.where(behind | (depth <= 0), np.inf, across)
    cosine = np.abs((way[:, :, MIDDLE] * unit).sum(axis=2))
    return Off(np.where(distance >= radius[:, None, None], across, -across), cosine, ratio, around)


class Images(NamedTuple):
    """Circles in one view. middle_px : (h, 2). axes_px : (h, 2) half of them, the longer one first;
    not a number and 0 where the camera does not look at a circle."""

    middle_px: Float[np.ndarray, "h 2"]
    axes_px: Float[np.ndarray, "h 2"]

    @property
    def axis_ratio(self) -> Float[np.ndarray, "h"]:
        """Shorter over longer axis."""
        return self.axes_px[:, 1] / np.maximum(self.axes_px[:, 0], 1e-12)


def image_circles(circles: Circles, matrix_px: Float[np.ndarray, "3 4"]) -> Images:
    """Where a view shows circles."""
    angle = np.arange(_AROUND) * (2 * np.pi / _AROUND)
    points = points_on_circles(circles, np.tile(angle, (len(circles.radius_mm), 1)))
    image = homogeneous_pixel(matrix_px, points)
    depth = image[..., 2:]
    seen = (depth.min(axis=(1, 2)) > 0)[:, None]
    uv = image[..., :2] / np.where(depth > 0, depth, 1.0)
    middle = uv.mean(axis=1)
    axes = np.linalg.svd(uv - middle[:, None], compute_uv=False) * np.sqrt(2 / _AROUND)
    return Images(np.where(seen, middle, np.nan), np.where(seen, axes, 0.0))


def touching(off: Off, within_px: float, tuning: RimTuning) -> Bool[np.ndarray, "h s"]:
    """Whether chords are those of arcs of circles, in views that do not show them edge-on."""
    near = np.abs(off.px[..., ON_ARC]).max(axis=2) < within_px
    # Between the places on the arc a chord lies a third of its bow inside.
    with np.errstate(invalid="ignore"):
        bow = 3 * np.abs(off.px[..., MIDDLE] - off.px[..., ON_ARC].mean(axis=2))
    tangent = off.cosine > np.cos(np.radians(tuning.tangent_deg))
    opened = off.axis_ratio > tuning.least_axis_ratio
    return near & tangent & opened & (bow < 2 * tuning.touch_px)


def points_on_circles(
    circles: Circles, angle: Float[np.ndarray, "h n"]
) -> Float[np.ndarray, "h n 3"]:
    """Points of circles; angles are counted from the first of the axes across their normals."""
    frame = complete_axes(circles.normal)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ frame
    return circles.centre_mm[:, None] + circles.radius_mm[:, None, None] * around


# numerical: Gauss-Newton steps, which converge.
_STEPS = 2
# numerical: a step further than this share of the radius, or of a radian, has left what is nearly
# linear.
_LARGEST_STEP = 0.3
# numerical: derivatives are differences over this share of the radius.
_SHARE = 1e-5
# numerical: of standard deviations: further off is as far off.
_FAR = 1e3


class CircleFit(NamedTuple):
    """The likeliest circle near one. covariance : of what `move_circle` moves, that of the errors
    found where they are larger than stated; not a number where the chords leave it open."""

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]


def move_circle(circle: Circles, by: Float[np.ndarray, "k 6"]) -> Circles:
    """One circle moved in k ways: by its centre (mm), its normal toward its two axes across (rad),
    and its radius (mm)."""
    normal = circle.normal + by[:, 3:5] @ complete_axes(circle.normal)[0]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return Circles(circle.centre_mm + by[:, :3], normal, circle.radius_mm + by[:, 5])


def fit_circle(chords: Chords, circle: Circles) -> CircleFit:
    """The likeliest circle near this one, by the two places of each chord that lie on its arc."""
    circle, equations = gauss_newton(
        lambda at: _residuals(chords, at),
        lambda at, step: move_circle(at, step * _scale(at)),
        circle,
        steps=_STEPS,
        largest_step=_LARGEST_STEP,
    )
    scale = _scale(circle)
    places, parameters = equations.squared.shape[1], len(scale)
    factor = misfit_factor(equations.chi_square, places - parameters)[0]
    return CircleFit(circle, factor * equations.covariance()[0] * scale[:, None] * scale)


def _scale(circle: Circles) -> Float[np.ndarray, "6"]:
    """What of each parameter moves the circle by about its radius."""
    radius = float(circle.radius_mm[0])
    return np.array([radius, radius, radius, 1.0, 1.0, radius])


def _residuals(chords: Chords, circle: Circles) -> Residuals:
    """How far each place is off the circle's image, by parameters in units of their scale."""
    steps = _SHARE * np.diag(_scale(circle))
    every = move_circle(circle, np.concatenate([np.zeros((1, 6)), steps, -steps]))
    off = off_circles(chords, every).px[..., ON_ARC] / chords.sigma_px[:, None]
    here, forth, back = np.split(np.clip(off, -_FAR, _FAR).reshape(len(off), -1), [1, 7])
    slope = (forth - back).T / (2 * _SHARE)
    return Residuals(here[..., None], slope[None, :, None])
