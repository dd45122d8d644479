"""Line segments of a picture: Nevatia and Babu's chain from masks to segments."""

from collections.abc import Callable
from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.errors import InputError
from trinoc.geometry import Intrinsics, Segments
from trinoc.image import Light, ResponseLike
from trinoc.numerics import in_bucket, in_float64, members
from trinoc.segments.junctions import with_junctions
from trinoc.segments.nevatia_babu import (
    EdgePoints,
    FittedLines,
    Shifts,
    bridged_runs,
    collinear_successors,
    combined_kernel,
    end_covariances,
    end_sigmas,
    error_model,
    fine_level,
    fit_lines,
    inflate_variance,
    is_on_ramp,
    is_sharp,
    is_straight,
    least_snr2,
    lines_near_ends,
    noise_variance,
    overlaps,
    runs_of_both_scales,
    shading_shifts,
    shifts_of_saturated,
    side_slopes,
    snapped_ends,
    typical_blur,
    without_neighbours,
)
from trinoc.segments.side_intensity import side_levels
from trinoc.segments.tuning import DEFAULT, EndTuning, SegmentTuning

# Binomial smoothings before the masks: the noise gain and all thresholds follow from it.
SMOOTHING = 1


def find_segments(
    image: Shaped[np.ndarray, "..."],
    *,
    tolerance_px: float = 1.6,
    false_alarms: float = 1.0,
    least_contrast: float = 7.0,
    arcs: bool = False,
    intrinsics: Intrinsics | None = None,
    response: ResponseLike = "linear",
    tuning: SegmentTuning = DEFAULT,
) -> Segments:
    """Straight edges of a picture, with polarity, contrast, covariance and junctions.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) picture of uint8, uint16 or real numbers; a colour's grey level
        is the mean of its channels, in whatever order they come.
    tolerance_px : coarsest deviation of an edge from a straight line, in pixels.
    false_alarms : how many segments noise alone may bring about in such a picture.
    least_contrast : fainter edges are left out; in 255ths of the picture's own range, which is
        that of 8, 10, 12, 14 or 16 bit, whichever is the least that holds all levels, or 0 to 1
        for real numbers that do not go beyond.
    arcs : whether to keep the chords of arcs, such as the rims of cylinders: pieces that deviate
        by up to `tolerance_px`.
    intrinsics : a lens whose distortion is taken out of the edge points before lines are
        fitted; the segments are then in undistorted pixels.
    response : how the camera makes grey levels of light: "linear", "srgb" (nearly every camera
        that is not an industrial one), or a number that bends the curve from 0, linear, past 1,
        sRGB. Edges are found in the grey levels and placed in the light: a response that is not
        linear moves a blurred edge toward its darker side.
    tuning : every other tuned constant of the chain; a benchmark or a study changes them.

    Returns segments whose first end comes first when walking with the darker side on the
    right as seen on the picture, so that every polarity is +1. Their `reasons` tell what
    widened a covariance beyond noise. Raises InputError for what is no picture, for knobs
    that are not positive, for a lens of another picture size and for an unknown response.

    After R. Nevatia and K. R. Babu, "Linear feature extraction and description", 1980,
    doi:10.1016/0146-664X(80)90049-0; docs/segments.md tells what differs.
    """
    for name, value in (("tolerance_px", tolerance_px), ("false_alarms", false_alarms)):
        if not value > 0:
            raise InputError(f"{name} is {value}, but must be positive.")
    if not least_contrast >= 0:
        raise InputError(f"least_contrast is {least_contrast}, but must not be negative.")
    picture = Light.from_picture(image, response)
    width, height = picture.size_px
    if intrinsics is not None and tuple(intrinsics.image_size_px) != (width, height):
        raise InputError(
            f"The picture is {width} x {height} px, but the lens was given for "
            f"{intrinsics.image_size_px[0]} x {intrinsics.image_size_px[1]} px: use the lens of "
            "this camera and resolution."
        )
    kernel = combined_kernel(SMOOTHING)
    fine = fine_level(picture, kernel)
    points, first = runs_of_both_scales(fine, kernel, tolerance_px, least_contrast, tuning.scales)
    lines = fit_lines(points, first)
    points, first, lines = _merged(points, first, lines, tolerance_px, tuning.ends.gap_px)

    usual_px2 = typical_blur(lines)
    slopes = side_slopes(picture.levels, points, first, usual_px2)
    keep = (
        is_sharp(lines, usual_px2, tuning.accept)
        & ~is_on_ramp(slopes)
        & (lines.snr2 > least_snr2(false_alarms, height * width))
        & (lines.contrast > tuning.accept.faint_share * least_contrast)
    )
    points, first = _points_of(points, first, keep)
    lines, slopes = lines.take(keep), slopes.take(keep)
    if not picture.is_linear:
        # Edges are placed in the light: what slopes there moves them.
        slopes = side_slopes(picture.light, points, first, usual_px2)

    usual_profile_px2 = fine.kernel_variance_px2 + usual_px2
    found = overlaps(points, first, lines, usual_profile_px2)
    spread = tuning.errors.blur_spread * usual_profile_px2
    own_blur = np.clip(lines.blur_px2, usual_px2 - spread, usual_px2 + spread)
    undisturbed = without_neighbours(points, lines, own_blur, found)
    lines = fit_lines(undisturbed, first)
    disturbed = error_model(
        picture.levels,
        picture.white,
        points,
        undisturbed,
        first,
        lines,
        found,
        usual_px2,
        tuning.errors,
    )
    noise = fine.sigma_strength / kernel.noise_gain * lines.light_per_level
    moved = shifts_of_saturated(
        picture.light,
        picture.light_of_white,
        noise,
        undisturbed,
        first,
        lines,
        disturbed,
        tuning.saturation,
    )
    # What is clipped does not slope.
    seen = moved.variance_px2 == 0
    shading = shading_shifts(slopes, lines, disturbed.crowded, tuning.errors)
    shaded = Shifts(*(seen * part for part in shading))
    undisturbed, lines = _shifted(undisturbed, lines, moved.shift_px + shaded.shift_px)
    to_image: Callable[[np.ndarray], np.ndarray] = np.asarray
    if intrinsics is not None and intrinsics.has_distortion:
        uv_px = _mapped(undisturbed.uv_px, intrinsics.undistort_pixel)
        lines = fit_lines(undisturbed._replace(uv_px=uv_px), first)
        to_image = partial(_mapped, through=intrinsics.distort_pixel)
    length = np.ptp(lines.extent_px, axis=1)
    variance, reasons = inflate_variance(
        disturbed,
        noise_variance(lines.variance_middle_px2, length),
        moved,
        shaded,
        tuning.errors,
    )
    rules = tuning.accept
    bevel = (length < rules.bevel_px) & (disturbed.crowded > rules.bevel_crowded)
    keep = (arcs | is_straight(lines, width, rules)) & (lines.contrast >= least_contrast) & ~bevel
    off_px2 = np.square(tuning.errors.off_share * disturbed.off_px)
    common_px2 = moved.variance_px2 + shaded.variance_px2
    kept = lines.take(keep), variance[keep], common_px2[keep], off_px2[keep], reasons[keep]
    return _as_segments(*kept, picture.levels, to_image, tuning.ends)


def _merged(
    points: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    tolerance_px: float,
    gap_px: float,
) -> tuple[EdgePoints, Int[np.ndarray, "g"], FittedLines]:
    """The same after joining collinear lines across small gaps."""
    successor = collinear_successors(lines, gap_px, tolerance_px / 2)
    if (successor < 0).all():
        return points, first, lines
    order, first, earliest, several = bridged_runs(successor, first, len(points.strength))
    points = points.take(order)
    lines = lines.take(earliest)
    again = fit_lines(*_points_of(points, first, several))
    return points, first, lines.replaced(several, again)


def _points_of(
    points: EdgePoints, first: Int[np.ndarray, "r"], keep: Bool[np.ndarray, "r"]
) -> tuple[EdgePoints, Int[np.ndarray, "g"]]:
    """The points of the lines that are kept, and where each of these begins."""
    stop = np.append(first[1:], len(points.strength))
    index, _, begins = members(first[keep], stop[keep])
    return points.take(index), begins


def _shifted(
    points: EdgePoints, lines: FittedLines, shift_px: Float[np.ndarray, "r"]
) -> tuple[EdgePoints, FittedLines]:
    """Lines and their points moved across, toward the brighter side."""
    if not shift_px.any():
        return points, lines
    way = lines.direction * shift_px[:, None]
    offset = np.stack([way[:, 1], -way[:, 0]], axis=-1)
    uv_px = points.uv_px + np.repeat(offset, lines.support, axis=0).astype(np.float32)
    return points._replace(uv_px=uv_px), lines._replace(centre_px=lines.centre_px + offset)


@in_float64
def _mapped(uv_px: Float[np.ndarray, "n 2"], through: Callable) -> np.ndarray:
    """Points taken through a lens or out of it; padded, so that few sizes compile."""
    return in_bucket(jax.vmap(through), uv_px.astype(np.float64))


def _as_segments(
    lines: FittedLines,
    variance_px2: Float[np.ndarray, "r"],
    common_px2: Float[np.ndarray, "r"],
    off_px2: Float[np.ndarray, "r 2"],
    reasons: Shaped[np.ndarray, "r"],
    grey: Float[np.ndarray, "h w"],
    to_image: Callable[[np.ndarray], np.ndarray],
    tuning: EndTuning,
) -> Segments:
    """Segments with ends at the crossings with what stops them, junctions and chains."""
    place = lines.centre_px, lines.direction, lines.extent_px
    near = lines_near_ends(*place, tuning.snap_px)
    partner, position = snapped_ends(*place, tuning.snap_px, near)
    sigma_along = end_sigmas(*place, lines.contrast, partner, near, tuning)
    endpoints = lines._replace(extent_px=position).endpoints_px
    return with_junctions(
        Segments(
            endpoints,
            end_covariances(lines.direction, variance_px2, common_px2, off_px2, sigma_along),
            np.ones(len(position), dtype=np.int64),
            lines.contrast,
            lines.support.astype(np.int64),
            (grey.shape[1], grey.shape[0]),
            reasons,
            side_levels=side_levels(grey, endpoints, to_image),
        ),
        near,
    )
