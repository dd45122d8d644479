"""Detection of line segments: the chain of Nevatia and Babu, from masks to segments."""

from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.errors import InputError, check_kind, real_number
from trinoc.geometry.intrinsics import A_LENS, Intrinsics, distort_pixels, undistort_pixels
from trinoc.geometry.segments import Segments
from trinoc.image.light import Light
from trinoc.image.response import ResponseLike
from trinoc.numerics.tables import take_rows
from trinoc.segments.junctions import with_junctions
from trinoc.segments.nevatia_babu.accept import is_sharp, is_straight, least_snr2, typical_blur
from trinoc.segments.nevatia_babu.edge_points import PyramidLevel, Runs
from trinoc.segments.nevatia_babu.endpoints import (
    NearEnds,
    end_sigmas,
    lines_near_ends,
    snap_ends,
)
from trinoc.segments.nevatia_babu.errors import (
    ErrorModel,
    end_covariances,
    error_model,
    inflate_variance,
    noise_variance,
)
from trinoc.segments.nevatia_babu.line_fit import (
    FittedLines,
    fit_lines,
    merge_collinear,
    refit_lines,
)
from trinoc.segments.nevatia_babu.masks import combined_kernel
from trinoc.segments.nevatia_babu.neighbours import find_overlaps, without_neighbours
from trinoc.segments.nevatia_babu.runs import find_runs, full_level
from trinoc.segments.nevatia_babu.saturated_edges import shifts_of_saturated
from trinoc.segments.nevatia_babu.side_slopes import (
    Shifts,
    SideSlopes,
    is_on_ramp,
    shading_shifts,
    side_slopes,
)
from trinoc.segments.side_intensity import side_levels
from trinoc.segments.tuning import DEFAULT, SegmentTuning

# numerical: fewest points of a run for a line fit, trimmed ends included.
_FEWEST_POINTS = 8


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
    """Detect straight edges, with polarity, contrast, covariance and junctions.

    Parameters
    ----------
    image : (h, w) or (h, w, 3)
        Image of uint8, uint16 or real numbers. The grey level of a colour is the mean of its
        channels, so their sequence has no effect.
    tolerance_px : float
        Largest deviation of an edge from a straight line.
    false_alarms : float
        Expected number of segments that noise alone causes in such an image.
    least_contrast : float
        Smallest contrast of a segment, in 255ths of the image's range. The range is the smallest of
        8, 10, 12, 14 or 16 bit that contains all levels. For real numbers up to 1, the range is 0
        to 1.
    arcs : bool
        True to keep chords of arcs, such as the rims of cylinders. The chords deviate from the arc
        by at most `tolerance_px`.
    intrinsics : Intrinsics, optional
        Lens whose distortion is removed from the edge points before lines are fitted. The segments
        are then in undistorted pixels.
    response : str, float or AbstractResponse
        Response of the camera, grey level against light. "linear" is typical of industrial cameras,
        "srgb" of nearly all others. A number interpolates between them: 0 for linear, 1 for sRGB.
        Edges are detected in the grey levels and located in the light, because a nonlinear response
        moves a blurred edge toward its darker side.
    tuning : SegmentTuning
        All other constants of the method, for benchmarks and studies.

    Returns
    -------
    Segments
        The darker side of each segment is on the right of the direction from its first to its
        second end, as displayed. Every polarity is therefore +1. `reasons` is the largest
        contribution to each covariance besides noise.

    Raises
    ------
    InputError
        If the argument is not an image, a number is not positive, or the response is unknown. If
        the lens belongs to another image size.

    References
    ----------
    R. Nevatia and K. R. Babu, "Linear feature extraction and description", 1980,
    doi:10.1016/0146-664X(80)90049-0. docs/segments.md lists the differences.
    """
    _check_options(tolerance_px, false_alarms, least_contrast)
    picture = Light.from_picture(image, response)
    _check_lens(intrinsics, picture.size_px)
    smooth = full_level(picture, combined_kernel())
    runs = find_runs(smooth, tolerance_px, least_contrast, tuning.scales)
    lines = fit_lines(runs, tuning.scales)
    runs, lines = merge_collinear(runs, lines, tolerance_px, tuning)
    blur_px2 = typical_blur(lines)
    runs, lines, slopes = _accept(picture, runs, lines, blur_px2, false_alarms, tuning)
    runs, lines, errors = _without_neighbours(smooth, runs, lines, blur_px2, tuning)
    runs, lines, shifts = _without_shifts(smooth, runs, lines, slopes, errors, tuning)
    lines, has_line, to_image = _undistort(runs, lines, intrinsics, tuning)
    wanted = has_line & _is_wanted(lines, arcs, least_contrast, tuning)
    lines, errors, shifts = take_rows((lines, errors, shifts), wanted)
    ends_px, along_px, near_ends = _place_ends(lines, tuning)
    covariance_px2, reasons = _covariances(lines, errors, shifts, along_px, tuning)
    segments = Segments(
        ends_px,
        covariance_px2,
        np.ones(len(ends_px), dtype=np.int64),
        lines.contrast,
        lines.support.astype(np.int64),
        picture.size_px,
        reasons,
        side_levels=side_levels(picture.levels, ends_px, to_image, tuning.junctions),
    )
    return with_junctions(segments, near_ends, tuning.junctions)


def _check_options(tolerance_px: float, false_alarms: float, least_contrast: float) -> None:
    for name, value in (("tolerance_px", tolerance_px), ("false_alarms", false_alarms)):
        if not real_number(value, name) > 0:
            raise InputError(f"{name} is {value}, but must be positive.")
    if not real_number(least_contrast, "least_contrast") >= 0:
        raise InputError(f"least_contrast is {least_contrast}, but must not be negative.")


def _check_lens(lens: Intrinsics | None, size_px: tuple[int, int]) -> None:
    check_kind(lens, (Intrinsics, type(None)), "lens", A_LENS)
    if lens is not None and tuple(lens.image_size_px) != size_px:
        raise InputError(
            f"The picture is {size_px[0]} x {size_px[1]} px, but the lens belongs to pictures of "
            f"{lens.image_size_px[0]} x {lens.image_size_px[1]} px. Use the lens of this camera at "
            "this resolution."
        )


def _accept(
    picture: Light,
    runs: Runs,
    lines: FittedLines,
    blur_px2: float,
    false_alarms: float,
    tuning: SegmentTuning,
) -> tuple[Runs, FittedLines, SideSlopes]:
    """Remove lines that are soft shadows, intensity ramps or noise.

    Returns (runs, lines, side slopes) of the remaining lines. `blur_px2` is the typical blur
    variance of edges.
    """
    slopes = side_slopes(picture.levels, runs, blur_px2, tuning.accept)
    keep = (
        is_sharp(lines, blur_px2, tuning.accept)
        & ~is_on_ramp(slopes, tuning.accept)
        & (lines.snr2 > least_snr2(false_alarms, picture.levels.size))
    )
    runs, lines, slopes = runs.take(keep), *take_rows((lines, slopes), keep)
    if not picture.is_linear:
        # Edges are located in the light, so its slopes shift them.
        slopes = side_slopes(picture.light, runs, blur_px2, tuning.accept)
    return runs, lines, slopes


def _without_neighbours(
    smooth: PyramidLevel, runs: Runs, lines: FittedLines, blur_px2: float, tuning: SegmentTuning
) -> tuple[Runs, FittedLines, ErrorModel]:
    """Correct the edge points for the shift that neighbouring edges cause, and fit the lines again.

    Returns (runs, lines, disturbances of each line).
    """
    profile_px2 = smooth.kernel_variance_px2 + blur_px2
    overlaps = find_overlaps(runs, lines, profile_px2, tuning.errors)
    points = without_neighbours(runs.points, lines, blur_px2, overlaps)
    cleaned = runs._replace(points=points)
    lines = refit_lines(cleaned, lines, cleaned.differ_from(runs), tuning.scales)
    arguments = smooth.picture, runs.points, cleaned, lines, overlaps, blur_px2, tuning.errors
    return cleaned, lines, error_model(*arguments)


def _without_shifts(
    smooth: PyramidLevel,
    runs: Runs,
    lines: FittedLines,
    slopes: SideSlopes,
    errors: ErrorModel,
    tuning: SegmentTuning,
) -> tuple[Runs, FittedLines, tuple[Shifts, Shifts]]:
    """Correct the positions of lines that saturation or shading shifts.

    Returns (runs, lines, (shifts by saturation, shifts by shading)).
    """
    saturated = shifts_of_saturated(smooth, runs, lines, errors, tuning.saturation)
    # A clipped side has no slope.
    is_unsaturated = saturated.variance_px2 == 0
    shading = shading_shifts(slopes, lines, errors.crowded, tuning.errors)
    shaded = Shifts(*(is_unsaturated * part for part in shading))
    shift_px = saturated.shift_px + shaded.shift_px
    if shift_px.any():
        # Toward the brighter side.
        displacement = lines.direction * shift_px[:, None]
        offset = np.stack([displacement[:, 1], -displacement[:, 0]], axis=-1)
        runs = runs.move(runs.points.uv_px + runs.spread(offset).astype(np.float32))
        lines = lines._replace(centre_px=lines.centre_px + offset)
    return runs, lines, (saturated, shaded)


def _undistort(
    runs: Runs, lines: FittedLines, lens: Intrinsics | None, tuning: SegmentTuning
) -> tuple[FittedLines, Bool[np.ndarray, "r"], Callable[[np.ndarray], np.ndarray]]:
    """Fit the lines to undistorted edge points.

    Returns (lines, mask of lines with enough points where the lens is invertible, mapping from
    undistorted to image pixels).
    """
    all_lines = np.ones(len(runs.count), dtype=bool)
    if lens is None or not lens.has_distortion:
        return lines, all_lines, np.asarray
    uv_px = undistort_pixels(lens, runs.points.uv_px)
    valid = np.asarray(np.isfinite(uv_px).all(axis=1))
    if valid.all():
        return fit_lines(runs.move(uv_px), tuning.scales), all_lines, partial(distort_pixels, lens)
    # A run with too few points inside the fold is not moved, and its line is not used.
    has_line = runs.total(valid.astype(np.float64)) >= _FEWEST_POINTS
    undistorted = runs.move(np.where(valid[:, None], uv_px, runs.points.uv_px))
    keep = valid | ~runs.spread(has_line)
    count = runs.total(keep.astype(np.float64)).astype(runs.count.dtype)
    undistorted = Runs.from_counts(undistorted.points.take(keep), count)

    def to_image(flat_px: np.ndarray) -> np.ndarray:
        # Some points next to a line that ends at the fold have no pixel.
        return np.nan_to_num(distort_pixels(lens, flat_px))

    return fit_lines(undistorted, tuning.scales), has_line, to_image


def _is_wanted(
    lines: FittedLines,
    arcs: bool,
    least_contrast: float,
    tuning: SegmentTuning,
) -> Bool[np.ndarray, "r"]:
    """Return the mask of the lines that are long and have enough contrast, (r,).

    Unless `arcs` is True, chords of arcs are excluded.
    """
    long = lines.pieces.length_px >= tuning.accept.least_length_px
    straight = arcs | is_straight(lines, tuning.accept)
    return straight & (lines.contrast >= least_contrast) & long


def _place_ends(
    lines: FittedLines, tuning: SegmentTuning
) -> tuple[Float[np.ndarray, "r 2 2"], Float[np.ndarray, "r 2"], NearEnds]:
    """Place the ends of each line: at the crossing with another line, if one is near.

    Other ends stay at the last edge point. Returns (ends, their standard deviations along the line,
    the pairs of an end and a nearby line that were tested).
    """
    pieces = lines.pieces
    near_ends = lines_near_ends(pieces, tuning.ends.snap_px)
    partner, position = snap_ends(pieces, tuning.ends.snap_px, near_ends, tuning.ends)
    along_px = end_sigmas(lines.contrast, partner, tuning.ends)
    return pieces._replace(extent_px=position).ends_px, along_px, near_ends


def _covariances(
    lines: FittedLines,
    errors: ErrorModel,
    shifts: tuple[Shifts, Shifts],
    along_px: Float[np.ndarray, "r 2"],
    tuning: SegmentTuning,
) -> tuple[Float[np.ndarray, "r 4 4"], Shaped[np.ndarray, "r"]]:
    """Return the covariance of the ends of each line, and its largest contribution besides noise.

    `along_px` are the standard deviations of both ends along the line.
    """
    noise_px2 = noise_variance(lines.variance_middle_px2, lines.pieces.length_px, tuning.errors)
    variance_px2, common_px2, reasons = inflate_variance(errors, noise_px2, *shifts, tuning.errors)
    off_px2 = np.square(tuning.errors.off_share * errors.off_px)
    arguments = lines.direction, variance_px2, common_px2, off_px2, along_px
    return end_covariances(*arguments), reasons
