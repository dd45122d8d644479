"""Fit matched lines to the grey levels of all their views."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.geometry.intrinsics import distort_pixels, undistort_pixels
from trinoc.geometry.projection import distances_from_line
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.image.light import Light
from trinoc.image.response import ResponseLike
from trinoc.match.observations.pictures_of_views import check_pictures, segments_of_views
from trinoc.match.pixels.images import LineImages, interpolate_offset, line_images
from trinoc.match.pixels.tuning import DEFAULT, PixelTuning
from trinoc.match.pixels.view_fit import PIXELS, ViewFit, fit_view
from trinoc.match.tracks.matches import Matches
from trinoc.match.tracks.unequal_errors import degrees_of_misfit, fit_tail, variance_factor
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, whitening
from trinoc.numerics.tails import chi_square_limit, chi_square_tail
from trinoc.numerics.vectors import complete_axes


@in_float64
def measure_lines(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    pictures: Mapping[str, Shaped[np.ndarray, "..."]],
    *,
    response: ResponseLike = "linear",
    tuning: PixelTuning = DEFAULT,
) -> Matches:
    """Fit every matched line to the grey levels of all its views.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments`.
    segments : mapping
        Segments of each view that were matched.
    rig : Rig
        The cameras of the matches.
    pictures : mapping
        Image of each view, as for `find_segments`.
    response : str, float or AbstractResponse
        Response of the cameras to light, as for `find_segments`.
    tuning : PixelTuning
        All tuned constants.

    Returns
    -------
    Matches
        The same tracks with new lines, fragments, covariances and `misfit`. The ends keep their
        positions along the lines. The mark `measure` is "pixels" for each view whose pixels are
        used, otherwise the reason.

    Raises
    ------
    InputError
        If a view has no image or no segments, or its image has another size than its camera.

    Notes
    -----
    The grey levels across the image of a line are modelled as a step between two levels, blurred by
    a Gaussian. Levels and blur are estimated in every view and eliminated, so that only the
    position remains. The four parameters of the line in space are estimated from the positions in
    all views together. A view without a clean step uses the position of its segment. A Hausman test
    compares the new line with the line of the segments.

    References
    ----------
    J. A. Hausman, "Specification tests in econometrics", 1978, doi:10.2307/1913827.
    """
    check_pictures("Measuring lines", matches.views, rig, pictures)
    segments_of_view = segments_of_views("Measuring lines", matches.views, segments)
    image_tables, views = [], []
    for view, name in enumerate(matches.views):
        view_segments = segments_of_view[name]
        lens = rig[name].intrinsics
        view_images = line_images(
            matches, view, view_segments, np.asarray(rig[name].matrix_px), lens
        )
        light = Light.from_picture(pictures[name], response)
        all_ends_px = np.asarray(view_segments.endpoints_px, dtype=np.float64)
        image_tables.append(view_images)
        views.append(fit_view(light, all_ends_px, lens, view_images, tuning))
    return apply_measurements(matches, rig, image_tables, views, tuning)


# numerical: number of Gauss-Newton steps.
_STEPS = 4


class PixelLineFit(NamedTuple):
    """Lines in space fitted to positions of their images.

    Attributes
    ----------
    move_mm : (t, 4)
        Displacements of the first end, then of the second end, along the two axes perpendicular to
        the line.
    covariance_mm2 : (t, 4, 4)
        Covariance of the displacements; NaN if the views do not determine the line.
    misfit : (t,)
        Chi-square of the residuals of all views.
    """

    move_mm: Float[np.ndarray, "t 4"]
    covariance_mm2: Float[np.ndarray, "t 4 4"]
    misfit: Float[np.ndarray, "t"]


def fit_lines_to_pixels(
    matrices_px: Float[np.ndarray, "v 3 4"],
    ends_mm: Float[np.ndarray, "t 2 3"],
    axes: Float[np.ndarray, "t 2 3"],
    points_px: Float[np.ndarray, "t v 2 2"],
    covariance_px2: Float[np.ndarray, "t v 2 2"],
    weight_of_view: Float[np.ndarray, "t v"],
) -> PixelLineFit:
    """Fit lines in space to two points on the image of each line in each view.

    `covariance_px2` is the covariance of the two points perpendicular to the image. `axes` are two
    unit vectors perpendicular to each initial line `ends_mm`. Views with `weight_of_view` 0 are
    ignored.
    """
    count = len(ends_mm)
    matrices = np.broadcast_to(matrices_px, (count, *matrices_px.shape))
    whitener = whitening(covariance_px2)

    def move_across(move: Float[np.ndarray, "t 4"]) -> Float[np.ndarray, "t 2 3"]:
        return ends_mm + move.reshape(count, 2, 2) @ axes

    def residuals(move: Float[np.ndarray, "t 4"]) -> Residuals:
        distances = distances_from_line(matrices, move_across(move)[:, None], points_px)
        by_move = np.einsum("tvpei,tai->tvpea", distances.by_ends, axes).reshape(
            *whitener.shape[:3], 4
        )
        distance = (whitener @ distances.distance_px[..., None])[..., 0]
        return Residuals(distance, whitener @ by_move, weight_of_view)

    move, equations = gauss_newton(residuals, np.add, np.zeros((count, 4)), steps=_STEPS)
    return PixelLineFit(move, equations.covariance(), equations.chi_square)


DISAGREES = "disagrees"
# numerical: number of parameters of a line.
_LINE_PARAMETERS = 4


def apply_measurements(
    matches: Matches,
    rig: Rig,
    images: Sequence[LineImages],
    views: Sequence[ViewFit],
    tuning: PixelTuning,
) -> Matches:
    """Return the matches with lines and fragments from the pixels, for tracks whose fit is valid.

    Other tracks keep the lines and fragments of their segments.
    """
    tracks, view_count = matches.index.shape
    outcome = np.full((tracks, view_count), "", dtype="<U16")
    points_px = np.zeros((tracks, view_count, 2, 2))
    points_px[..., 0, :] = 1.0
    covariance = np.tile(np.eye(2), (tracks, view_count, 1, 1))
    for view, (view_images, view_fit) in enumerate(zip(images, views, strict=True)):
        rows = view_images.track
        outcome[rows, view] = view_fit.outcome
        points_px[rows, view] = (
            view_images.ends_px + view_fit.offset_px[..., None] * view_images.normal[:, None]
        )
        covariance[rows, view] = view_fit.covariance_px2
    step = matches.lines_mm[:, 1] - matches.lines_mm[:, 0]
    unit = step / np.linalg.norm(step, axis=1)[:, None]
    axes = complete_axes(unit)
    matrices = np.stack([np.asarray(rig[name].matrix_px) for name in matches.views])
    is_observed = matches.index >= 0
    fit = fit_lines_to_pixels(
        matrices, matches.lines_mm, axes, points_px, covariance, is_observed.astype(np.float64)
    )
    is_sound = np.asarray(np.isfinite(fit.covariance_mm2).all(axis=(1, 2)))
    move = np.where(is_sound[:, None], fit.move_mm, 0.0)
    move_covariance = np.where(
        is_sound[:, None, None], fit.covariance_mm2, np.eye(_LINE_PARAMETERS)
    )
    misfit = np.where(is_sound, fit.misfit, 0.0)
    is_sound &= (outcome == PIXELS).any(axis=1)

    # Both estimates, in coordinates across both ends and along the line.
    rotation = np.zeros((tracks, 6, 6))
    rotation[:, 0:2, 0:3] = rotation[:, 2:4, 3:6] = axes
    rotation[:, 4, 0:3] = rotation[:, 5, 3:6] = unit
    covariance_before = rotation @ matches.covariance_mm2 @ rotation.mT
    freedom = degrees_of_misfit(matches.index)
    is_sure = is_sound & (freedom > 0) & (matches.posterior > tuning.sure_posterior)
    noise_tuning = NoiseTuning(tail_of_images=tuning.tail)
    tail = fit_tail(misfit[is_sure], freedom[is_sure], has_images=True, tuning=noise_tuning)
    move_covariance = move_covariance * variance_factor(misfit, freedom, tail)[:, None, None]
    difference = hausman(
        move, covariance_before[:, :4, :4], move_covariance, tuning.min_difference_share
    )
    limit = chi_square_limit(tuning.min_probability, _LINE_PARAMETERS)
    # If the estimates differ too much, that of the pixels is used if its views agree, as two always
    # do: segments are wrong more often than pixels. Its covariance then covers both estimates.
    in_three_views = is_observed.sum(axis=1) > 2
    views_agree = chi_square_tail(misfit, np.maximum(freedom, 1)) > tuning.min_probability
    is_measured = is_sound & ((difference <= limit) | views_agree)
    move_covariance = move_covariance * np.maximum(difference / limit, 1.0)[:, None, None]
    ends, ends_covariance = _move_lines(
        matches.lines_mm, rotation, covariance_before, move, move_covariance
    )
    depth = np.einsum("vj,tej->tve", matrices[:, 2, :3], ends) + matrices[:, 2, 3][:, None]
    is_measured &= ((depth > 0).all(axis=2) | ~is_observed).all(axis=1) & np.isfinite(ends).all(
        axis=(1, 2)
    )
    outcome = np.where((outcome == PIXELS) & ~is_measured[:, None], DISAGREES, outcome)
    fragments, fragments_covariance = _measured_fragments(matches, rig, images, views, outcome)
    counts = {
        "measured: lines by their pixels": int(is_measured.sum()),
        "measured: lines by their segments": int((~is_measured).sum()),
    }
    measured = dataclasses.replace(
        matches,
        fragments_px=fragments,
        lines_mm=np.where(is_measured[:, None, None], ends, matches.lines_mm),
        covariance_mm2=np.where(
            is_measured[:, None, None], ends_covariance, matches.covariance_mm2
        ),
        counts=matches.counts | counts,
        fragments_covariance_px2=fragments_covariance,
        rig_covariance_mm2=None,
        misfit=None
        if matches.misfit is None
        else np.where(is_measured & in_three_views, misfit, matches.misfit),
    )
    return measured.with_marks(measure=outcome)


def hausman(
    difference: Float[np.ndarray, "t k"],
    robust: Float[np.ndarray, "t k k"],
    efficient: Float[np.ndarray, "t k k"],
    smallest_share: float,
) -> Float[np.ndarray, "t"]:
    """Hausman statistic of the difference between a robust and an efficient estimate, (t,).

    If both estimates are right, the statistic has a chi-square distribution with k degrees of
    freedom. `robust` and `efficient` are the covariances of the two estimates. The covariance of
    the difference is robust - efficient, in every direction at least `smallest_share` of
    `efficient`.
    """
    root = np.linalg.cholesky(efficient)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ robust @ inverse.mT)
    along = (vectors.mT @ inverse @ difference[..., None])[..., 0]
    return (along**2 / np.maximum(values - 1, smallest_share)).sum(axis=1)


def _move_lines(
    ends_mm: Float[np.ndarray, "t 2 3"],
    rotation: Float[np.ndarray, "t 6 6"],
    covariance_before: Float[np.ndarray, "t 6 6"],
    move: Float[np.ndarray, "t 4"],
    move_covariance: Float[np.ndarray, "t 4 4"],
) -> tuple[np.ndarray, np.ndarray]:
    """Move the ends of lines perpendicular to the lines, and return the ends with their covariance.

    The positions along the lines change by their correlation with the move. `rotation` maps the
    world coordinates of both ends to four coordinates across the line and two along the line.
    """
    regression = np.linalg.solve(covariance_before[:, :4, :4], covariance_before[:, :4, 4:]).mT
    move_along = (regression @ move[..., None])[..., 0]
    conditional = covariance_before[:, 4:, 4:] - regression @ covariance_before[:, :4, 4:]
    cross_covariance = regression @ move_covariance
    covariance_after = np.zeros_like(covariance_before)
    covariance_after[:, :4, :4], covariance_after[:, 4:, :4], covariance_after[:, :4, 4:] = (
        move_covariance,
        cross_covariance,
        cross_covariance.mT,
    )
    covariance_after[:, 4:, 4:] = conditional + cross_covariance @ regression.mT
    step = (rotation.mT @ np.concatenate([move, move_along], axis=1)[..., None])[..., 0]
    return ends_mm + step.reshape(-1, 2, 3), rotation.mT @ covariance_after @ rotation


def _measured_fragments(
    matches: Matches,
    rig: Rig,
    images: Sequence[LineImages],
    views: Sequence[ViewFit],
    outcome: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the fragments, moved to the measured images of the lines, and their covariance."""
    fragments, covariance = matches.fragments_px.copy(), None
    if matches.fragments_covariance_px2 is not None:
        covariance = matches.fragments_covariance_px2.copy()
    for view, (view_images, fit) in enumerate(zip(images, views, strict=True)):
        lens, rows = rig[matches.views[view]].intrinsics, view_images.track
        is_measured = outcome[rows, view] == PIXELS
        undistorted = undistort_pixels(lens, matches.fragments_px[rows, view])
        along_px = np.einsum(
            "sei,si->se", undistorted - view_images.ends_px[:, :1], view_images.direction
        )
        share = along_px / view_images.length_px[:, None]
        across_px = interpolate_offset(fit.offset_px, share)
        moved_px = view_images.ends_px[:, :1] + along_px[..., None] * view_images.direction[:, None]
        moved_px = distort_pixels(
            lens, moved_px + across_px[..., None] * view_images.normal[:, None]
        )
        # A fragment that would end beyond the fold of the lens is not moved.
        is_valid = is_measured & np.isfinite(moved_px).all(axis=(1, 2))
        fragments[rows[is_valid], view] = moved_px[is_valid]
        if covariance is None:
            continue
        weight = np.stack([1 - share, share], axis=2)
        covariance_across = np.where(
            is_measured[:, None, None],
            weight @ fit.covariance_px2 @ weight.mT,
            fit.widening_px2[:, None, None] * np.ones((2, 2)),
        )
        added_covariance = np.einsum(
            "sef,si,sj->seifj", covariance_across, view_images.normal, view_images.normal
        ).reshape(-1, 4, 4)
        along_projector = np.einsum(
            "ef,si,sj->seifj", np.eye(2), view_images.direction, view_images.direction
        ).reshape(-1, 4, 4)
        covariance_before = covariance[rows, view]
        retained = np.where(
            is_measured[:, None, None],
            along_projector @ covariance_before @ along_projector,
            covariance_before,
        )
        covariance[rows, view] = retained + added_covariance
    return fragments, covariance
