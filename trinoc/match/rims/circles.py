"""Circles in space, the offsets of segments from their images, and the least-squares fit of one
circle.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import homogeneous_pixel, pixel_change, project_by_matrix
from trinoc.geometry.rig import Rig
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, misfit_factor
from trinoc.numerics.vectors import complete_axes, cross_3d, vector3

# numerical: a chord fitted to the points of an arc crosses it at the Gauss points, given as shares
# of its half length. The errors at both points are independent.
GAUSS = 1 / np.sqrt(3)
# numerical: positions along a chord: both Gauss points, its middle, its ends.
_POSITIONS = np.array([-GAUSS, GAUSS, 0.0, -1.0, 1.0])
# numerical: columns of `_POSITIONS`.
ON_ARC, MIDDLE, ENDS = slice(0, 2), 2, slice(3, 5)
# numerical: number of columns without the ends.
_COUNT_WITHOUT_ENDS = 3
# numerical: number of points round a circle that determine the axes of its image.
_CIRCLE_POINTS = 8


def usual_mm_per_px(
    lines_mm: Float[np.ndarray, "t 2 3"], rig: Rig, views: tuple[str, ...]
) -> float:
    """Return the size of one pixel at the lines, median over lines and views, mm.

    Without lines, the result is 1.
    """
    length = np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1)
    scales = []
    for name in views:
        image = project_by_matrix(np.asarray(rig[name].matrix_px), lines_mm)
        scales.append(length / np.linalg.norm(image[:, 1] - image[:, 0], axis=1))
    return float(np.median(scales)) if len(lines_mm) else 1.0


class Circles(NamedTuple):
    """h circles in space.

    Attributes
    ----------
    centre_mm : (h, 3)
        Centres, world frame.
    normal : (h, 3)
        Unit normals of the planes of the circles.
    radius_mm : (h,)
        Radii.
    """

    centre_mm: Float[np.ndarray, "h 3"]
    normal: Float[np.ndarray, "h 3"]
    radius_mm: Float[np.ndarray, "h"]


class Chords(NamedTuple):
    """Segments of all views in one table, as possible chords of circles.

    A chord is a straight segment that the detector fitted to a part of a curved edge, an arc.

    Attributes
    ----------
    view : (n,)
        View of each segment, as an index of `Matches.views`.
    segment : (n,)
        Index of the segment in the caller's input.
    points_px : (n, k, 2)
        Points on the segment, undistorted pixels. Columns `ON_ARC`: the two points that lie on the
        arc if the segment is a chord. Columns `MIDDLE` and `ENDS`: its midpoint and its ends.
    rays : (n, k, 3)
        Unit viewing rays of these points, world frame.
    centre_mm, matrix_px : (n, 3) and (n, 3, 4)
        Centre and projection matrix of the camera.
    sigma_px : (n,)
        Standard deviation of the two points on the arc, across the segment.
    length_px : (n,)
        Length of the segment.
    """

    view: Int[np.ndarray, "n"]
    segment: Int[np.ndarray, "n"]
    points_px: Float[np.ndarray, "n k 2"]
    rays: Float[np.ndarray, "n k 3"]
    centre_mm: Float[np.ndarray, "n 3"]
    matrix_px: Float[np.ndarray, "n 3 4"]
    sigma_px: Float[np.ndarray, "n"]
    length_px: Float[np.ndarray, "n"]


class CircleOffsets(NamedTuple):
    """Offsets of s chords from the images of h circles, at k points of each chord.

    Attributes
    ----------
    offset_px : (h, s, k)
        Distance of each point from the circle's image, positive outside; inf behind the camera.
    cosine : (h, s)
        Cosine of the angle between the chord and the tangent of the circle's image.
    axis_ratio : (h, s)
        Minor over major axis of the circle's image in the view of the chord.
    nearest_mm : (h, s, k, 3)
        Point of the circle nearest to each point, world frame.
    """

    offset_px: Float[np.ndarray, "h s k"]
    cosine: Float[np.ndarray, "h s"]
    axis_ratio: Float[np.ndarray, "h s"]
    nearest_mm: Float[np.ndarray, "h s k 3"]


def collect_chords(inputs: MatchInput, views: tuple[str, ...]) -> Chords:
    """Collect the segments of all views in one table. `views` are the views of the matches."""
    parts = []
    for number, name in enumerate(views):
        view = inputs.names.index(name)
        matrix = np.asarray(inputs.frames[0].cameras.matrix_px)[view]
        ends, covariance = inputs.ends_px[view], inputs.covariance_px2[view]
        half = (ends[:, 1] - ends[:, 0]) / 2
        length = 2 * np.linalg.norm(half, axis=1)
        points = ends.mean(axis=1)[:, None] + _POSITIONS[:, None] * half[:, None]
        inverse = np.linalg.inv(matrix[:, :3])
        rays = (
            np.concatenate([points, np.ones((len(ends), len(_POSITIONS), 1))], axis=2) @ inverse.T
        )
        normal = np.stack([-half[:, 1], half[:, 0]], axis=1) / (length / 2)[:, None]
        blocks = covariance.reshape(-1, 2, 2, 2, 2)
        end_variance = np.einsum("neiej,ni,nj->ne", blocks, normal, normal).mean(axis=1)
        parts.append(
            Chords(
                np.full(len(ends), number),
                inputs.order[view],
                points,
                rays / np.linalg.norm(rays, axis=2, keepdims=True),
                np.tile(-inverse @ matrix[:, 3], (len(ends), 1)),
                np.tile(matrix, (len(ends), 1, 1)),
                # The ends of a fitted line have twice the variance of its Gauss points.
                np.sqrt(end_variance / 2),
                length,
            )
        )
    return Chords(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def circle_offsets(chords: Chords, circles: Circles, *, with_ends: bool = False) -> CircleOffsets:
    """Compute the offsets of all chords from all circles, at three points of each chord.

    With `with_ends`, the two ends of each chord are added.
    """
    centre, normal, radius = circles
    unit = (chords.points_px[:, 4] - chords.points_px[:, 3]) / chords.length_px[:, None]
    if not with_ends:
        points = chords.points_px[:, :_COUNT_WITHOUT_ENDS]
        rays = chords.rays[:, :_COUNT_WITHOUT_ENDS]
        chords = chords._replace(points_px=points, rays=rays)
    to_plane = (normal * centre).sum(axis=1)[:, None] - normal @ chords.centre_mm.T
    normal_component = (normal @ chords.rays.reshape(-1, 3).T).reshape(
        len(normal), *chords.rays.shape[:2]
    )
    depth = to_plane[..., None] / np.where(np.abs(normal_component) > 1e-9, normal_component, 1e-9)
    radial_vector = (
        chords.centre_mm[:, None] + depth[..., None] * chords.rays - centre[:, None, None]
    )
    distance = np.linalg.norm(radial_vector, axis=3)
    radial = radial_vector / np.maximum(distance, 1e-12)[..., None]
    nearest = centre[:, None, None] + radius[:, None, None, None] * radial
    tangent = cross_3d(normal[:, None, None], radial)
    image, image_tangent = np.empty_like(nearest), np.empty_like(nearest[..., :2])
    axis_ratio = np.zeros(distance.shape[:2])
    for view in np.unique(chords.view).tolist():
        in_view = chords.view == view
        matrix = chords.matrix_px[in_view.argmax()]
        image[:, in_view] = projected = homogeneous_pixel(matrix, nearest[:, in_view])
        uv = vector3(projected)[:2] / projected[..., 2]
        tangent_change = vector3(tangent[:, in_view] @ matrix[:, :3].T)
        image_tangent[:, in_view] = np.stack(
            pixel_change((uv[0], uv[1]), projected[..., 2], tangent_change), axis=-1
        )
        axis_ratio[:, in_view] = image_circles(circles, matrix).axis_ratio[:, None]
    uv, is_behind = image[..., :2] / image[..., 2:], image[..., 2] <= 0
    image_tangent = image_tangent / np.maximum(
        np.linalg.norm(image_tangent, axis=3, keepdims=True), 1e-12
    )
    gap = chords.points_px - uv
    distance_px = np.abs(gap[..., 0] * image_tangent[..., 1] - gap[..., 1] * image_tangent[..., 0])
    distance_px = np.where(is_behind | (depth <= 0), np.inf, distance_px)
    cosine = np.abs((image_tangent[:, :, MIDDLE] * unit).sum(axis=2))
    return CircleOffsets(
        np.where(distance >= radius[:, None, None], distance_px, -distance_px),
        cosine,
        axis_ratio,
        nearest,
    )


class CircleImages(NamedTuple):
    """Images of h circles in one view: ellipses.

    Attributes
    ----------
    middle_px : (h, 2)
        Mean of the image points. NaN if a part of the circle lies behind the camera.
    axes_px : (h, 2)
        Major and minor half axis. 0 if a part of the circle lies behind the camera.
    """

    middle_px: Float[np.ndarray, "h 2"]
    axes_px: Float[np.ndarray, "h 2"]

    @property
    def axis_ratio(self) -> Float[np.ndarray, "h"]:
        """Minor over major axis of each image, (h,)."""
        return self.axes_px[:, 1] / np.maximum(self.axes_px[:, 0], 1e-12)


def image_circles(circles: Circles, matrix_px: Float[np.ndarray, "3 4"]) -> CircleImages:
    """Compute the images of circles in the view with the given projection matrix."""
    angle = np.arange(_CIRCLE_POINTS) * (2 * np.pi / _CIRCLE_POINTS)
    points = points_on_circles(circles, np.tile(angle, (len(circles.radius_mm), 1)))
    image = homogeneous_pixel(matrix_px, points)
    depth = image[..., 2:]
    is_visible = (depth.min(axis=(1, 2)) > 0)[:, None]
    uv = image[..., :2] / np.where(depth > 0, depth, 1.0)
    middle = uv.mean(axis=1)
    axes = np.linalg.svd(uv - middle[:, None], compute_uv=False) * np.sqrt(2 / _CIRCLE_POINTS)
    return CircleImages(np.where(is_visible, middle, np.nan), np.where(is_visible, axes, 0.0))


def are_touching(
    offsets: CircleOffsets, limit_px: float, tuning: RimTuning
) -> Bool[np.ndarray, "h s"]:
    """Return the mask of the chords that lie on each circle's image, (h, s).

    The two points on the arc must be within `limit_px` of the image, the direction close to the
    tangent, and the image not too narrow.
    """
    is_near = np.abs(offsets.offset_px[..., ON_ARC]).max(axis=2) < limit_px
    # In the middle between its intersections, a chord lies a third of the sagitta inside the arc.
    with np.errstate(invalid="ignore"):
        bow = 3 * np.abs(
            offsets.offset_px[..., MIDDLE] - offsets.offset_px[..., ON_ARC].mean(axis=2)
        )
    is_tangent = offsets.cosine > np.cos(np.radians(tuning.tangent_deg))
    is_open = offsets.axis_ratio > tuning.min_axis_ratio
    return is_near & is_tangent & is_open & (bow < 2 * tuning.touch_px)


def points_on_circles(
    circles: Circles, angle: Float[np.ndarray, "h n"]
) -> Float[np.ndarray, "h n 3"]:
    """Return the points of circles at the given angles, rad, (h, n, 3) mm.

    Angles are measured in the plane of the circle, from the first of its two axes
    `complete_axes(normal)`.
    """
    frame = complete_axes(circles.normal)
    radial = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ frame
    return circles.centre_mm[:, None] + circles.radius_mm[:, None, None] * radial


# numerical: number of Gauss-Newton steps.
_STEPS = 2
# numerical: largest step, as a share of the radius or of a radian. Larger steps are not linear.
_LARGEST_STEP = 0.3
# numerical: step of the numerical derivatives, as a share of the radius.
_DIFFERENCE_STEP = 1e-5
# numerical: limit of residuals, in standard deviations.
_MAX_SIGMAS = 1e3


class CircleFit(NamedTuple):
    """Fitted circle with its covariance.

    Attributes
    ----------
    circle : Circles
        The circle; its arrays have one row.
    covariance : (6, 6)
        Covariance of the parameters of `move_circle`, scaled if the residuals are larger than the
        stated errors. NaN if the chords do not determine the circle.
    """

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]


def move_circle(circle: Circles, parameters: Float[np.ndarray, "k 6"]) -> Circles:
    """Return one circle changed by each of k steps.

    The first three parameters of a step shift the centre (mm). The next two turn the normal toward
    its two axes (rad). The last one changes the radius (mm).
    """
    normal = circle.normal + parameters[:, 3:5] @ complete_axes(circle.normal)[0]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return Circles(
        circle.centre_mm + parameters[:, :3], normal, circle.radius_mm + parameters[:, 5]
    )


def fit_circle(chords: Chords, circle: Circles) -> CircleFit:
    """Fit a circle in space to chords, from an initial circle.

    The residuals are the offsets of the two points of each chord that lie on its arc.
    """
    circle, equations = gauss_newton(
        lambda current: _residuals(chords, current),
        lambda current, step: move_circle(current, step * _step_scale(current)),
        circle,
        steps=_STEPS,
        largest_step=_LARGEST_STEP,
    )
    scale = _step_scale(circle)
    point_count, parameters = equations.squared.shape[1], len(scale)
    factor = misfit_factor(equations.chi_square, point_count - parameters)[0]
    return CircleFit(circle, factor * equations.covariance()[0] * scale[:, None] * scale)


def _step_scale(circle: Circles) -> Float[np.ndarray, "6"]:
    """Return the step of each parameter that displaces points of the circle by about its radius."""
    radius = float(circle.radius_mm[0])
    return np.array([radius, radius, radius, 1.0, 1.0, radius])


def _residuals(chords: Chords, circle: Circles) -> Residuals:
    """Return the whitened offsets of all points from the circle's image, with numerical
    derivatives.

    The derivatives are by the parameters of `move_circle` in units of `_step_scale`.
    """
    steps = _DIFFERENCE_STEP * np.diag(_step_scale(circle))
    circles = move_circle(circle, np.concatenate([np.zeros((1, 6)), steps, -steps]))
    scaled = circle_offsets(chords, circles).offset_px[..., ON_ARC] / chords.sigma_px[:, None]
    at_circle, forward, backward = np.split(
        np.clip(scaled, -_MAX_SIGMAS, _MAX_SIGMAS).reshape(len(scaled), -1), [1, 7]
    )
    slope = (forward - backward).T / (2 * _DIFFERENCE_STEP)
    return Residuals(at_circle[..., None], slope[None, :, None])
