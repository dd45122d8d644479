"""Line segments of a picture: Nevatia and Babu's chain from masks to segments."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.errors import InputError
from trinoc.geometry import Intrinsics, Segments, distort_pixels, undistort_pixels
from trinoc.image import Light, ResponseLike
from trinoc.numerics import take_rows
from trinoc.segments.junctions import with_junctions
from trinoc.segments.nevatia_babu import (
    ErrorModel,
    FittedLines,
    Level,
    Runs,
    Shifts,
    SideSlopes,
    combined_kernel,
    end_covariances,
    end_sigmas,
    error_model,
    find_overlaps,
    find_runs,
    fit_lines,
    full_level,
    inflate_variance,
    is_on_ramp,
    is_sharp,
    is_straight,
    least_snr2,
    lines_near_ends,
    merge_collinear,
    noise_variance,
    shading_shifts,
    shifts_of_saturated,
    side_slopes,
    snap_ends,
    typical_blur,
    without_neighbours,
)
from trinoc.segments.side_intensity import side_levels
from trinoc.segments.tuning import DEFAULT, SegmentTuning


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
    _check_options(tolerance_px, false_alarms, least_contrast)
    picture = Light.from_picture(image, response)
    _check_lens(intrinsics, picture.size_px)
    fine = full_level(picture, combined_kernel())
    runs = find_runs(fine, tolerance_px, least_contrast, tuning.scales)
    lines = fit_lines(runs)
    runs, lines = merge_collinear(runs, lines, tolerance_px, tuning.ends.gap_px)
    edges = _accept_edges(picture, runs, lines, false_alarms, least_contrast, tuning)
    runs, placed = _correct_places(fine, edges, tuning)
    placed, to_image = _undistort(runs, placed, intrinsics)
    wanted = _is_wanted(placed, picture.size_px[0], arcs, least_contrast, tuning)
    return _segments_of(take_rows(placed, wanted), picture, to_image, tuning)


def _check_options(tolerance_px: float, false_alarms: float, least_contrast: float) -> None:
    for name, value in (("tolerance_px", tolerance_px), ("false_alarms", false_alarms)):
        if not value > 0:
            raise InputError(f"{name} is {value}, but must be positive.")
    if not least_contrast >= 0:
        raise InputError(f"least_contrast is {least_contrast}, but must not be negative.")


def _check_lens(lens: Intrinsics | None, size_px: tuple[int, int]) -> None:
    if lens is not None and tuple(lens.image_size_px) != size_px:
        raise InputError(
            f"The picture is {size_px[0]} x {size_px[1]} px, but the lens was given for "
            f"{lens.image_size_px[0]} x {lens.image_size_px[1]} px: use the lens of "
            "this camera and resolution."
        )


class _Edges(NamedTuple):
    """Lines that are edges of the scene, their points, and slopes of the light beside them;
    `usual_px2` is the variance of the usual blur."""

    runs: Runs
    lines: FittedLines
    slopes: SideSlopes
    usual_px2: float


def _accept_edges(
    picture: Light,
    runs: Runs,
    lines: FittedLines,
    false_alarms: float,
    least_contrast: float,
    tuning: SegmentTuning,
) -> _Edges:
    """Without soft shadows, slopes of the light, noise, and what is far too faint."""
    usual_px2 = typical_blur(lines)
    slopes = side_slopes(picture.levels, runs, usual_px2)
    keep = (
        is_sharp(lines, usual_px2, tuning.accept)
        & ~is_on_ramp(slopes)
        & (lines.snr2 > least_snr2(false_alarms, picture.levels.size))
        & (lines.contrast > tuning.accept.faint_share * least_contrast)
    )
    runs, lines, slopes = runs.take(keep), *take_rows((lines, slopes), keep)
    if not picture.is_linear:
        # Edges are placed in the light: what slopes there moves them.
        slopes = side_slopes(picture.light, runs, usual_px2)
    return _Edges(runs, lines, slopes, usual_px2)


class _PlacedLines(NamedTuple):
    """Lines with what moved them taken out, and what may be left of it."""

    lines: FittedLines
    errors: ErrorModel
    saturated: Shifts
    shaded: Shifts


def _correct_places(fine: Level, edges: _Edges, tuning: SegmentTuning) -> tuple[Runs, _PlacedLines]:
    """(points, lines) without the pull of neighbours, of clipping, and of shading."""
    picture, (runs, lines, slopes, usual_px2) = fine.picture, edges
    profile_px2 = fine.kernel_variance_px2 + usual_px2
    near = find_overlaps(runs, lines, profile_px2)
    spread = tuning.errors.blur_spread * profile_px2
    own_blur = np.clip(lines.blur_px2, usual_px2 - spread, usual_px2 + spread)
    cleaned = runs._replace(points=without_neighbours(runs.points, lines, own_blur, near))
    lines = fit_lines(cleaned)
    errors = error_model(picture, runs.points, cleaned, lines, near, usual_px2, tuning.errors)
    saturated = shifts_of_saturated(fine, cleaned, lines, errors, tuning.saturation)
    # What is clipped does not slope.
    seen = saturated.variance_px2 == 0
    shading = shading_shifts(slopes, lines, errors.crowded, tuning.errors)
    shaded = Shifts(*(seen * part for part in shading))
    cleaned, lines = _shift(cleaned, lines, saturated.shift_px + shaded.shift_px)
    return cleaned, _PlacedLines(lines, errors, saturated, shaded)


def _shift(
    runs: Runs, lines: FittedLines, shift_px: Float[np.ndarray, "r"]
) -> tuple[Runs, FittedLines]:
    """Lines and their points moved across, toward the brighter side."""
    if not shift_px.any():
        return runs, lines
    way = lines.direction * shift_px[:, None]
    offset = np.stack([way[:, 1], -way[:, 0]], axis=-1)
    moved = runs.moved(runs.points.uv_px + runs.spread(offset).astype(np.float32))
    return moved, lines._replace(centre_px=lines.centre_px + offset)


def _undistort(
    runs: Runs, placed: _PlacedLines, lens: Intrinsics | None
) -> tuple[_PlacedLines, Callable[[np.ndarray], np.ndarray]]:
    """(lines through undistorted points, the way back into the picture)."""
    if lens is None or not lens.has_distortion:
        return placed, np.asarray
    flat = runs.moved(undistort_pixels(lens, runs.points.uv_px))
    return placed._replace(lines=fit_lines(flat)), partial(distort_pixels, lens)


def _is_wanted(
    placed: _PlacedLines, width_px: int, arcs: bool, least_contrast: float, tuning: SegmentTuning
) -> Bool[np.ndarray, "r"]:
    """No arcs, unless they are wanted, no bevels of corners, and nothing fainter than wanted."""
    lines, rules = placed.lines, tuning.accept
    short = np.ptp(lines.extent_px, axis=1) < rules.bevel_px
    bevel = short & (placed.errors.crowded > rules.bevel_crowded)
    straight = arcs | is_straight(lines, width_px, rules)
    return straight & (lines.contrast >= least_contrast) & ~bevel


def _segments_of(
    placed: _PlacedLines,
    picture: Light,
    to_image: Callable[[np.ndarray], np.ndarray],
    tuning: SegmentTuning,
) -> Segments:
    """Segments with ends at the crossings with what stops them, junctions and chains."""
    lines, errors, saturated, shaded = placed
    noise_px2 = noise_variance(lines.variance_middle_px2, np.ptp(lines.extent_px, axis=1))
    variance_px2, reasons = inflate_variance(errors, noise_px2, saturated, shaded, tuning.errors)
    common_px2 = saturated.variance_px2 + shaded.variance_px2
    off_px2 = np.square(tuning.errors.off_share * errors.off_px)

    near = lines_near_ends(lines.pieces, tuning.ends.snap_px)
    partner, position = snap_ends(lines.pieces, tuning.ends.snap_px, near)
    along_px = end_sigmas(lines.pieces, lines.contrast, partner, near, tuning.ends)
    ends_px = lines.pieces._replace(extent_px=position).ends_px
    return with_junctions(
        Segments(
            ends_px,
            end_covariances(lines.direction, variance_px2, common_px2, off_px2, along_px),
            np.ones(len(position), dtype=np.int64),
            lines.contrast,
            lines.support.astype(np.int64),
            picture.size_px,
            reasons,
            side_levels=side_levels(picture.levels, ends_px, to_image),
        ),
        near,
    )
