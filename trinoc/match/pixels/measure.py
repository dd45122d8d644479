"""Matched lines measured in the grey levels of all their views."""

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

    Beside the image of a line, each view's pixels are a step between two levels, blurred by a
    Gaussian. Levels and blur are fitted in every view and eliminated. What remains says where the
    line's image is, and the four parameters of the line in space follow from all views together.
    A view that shows no clean step there keeps its segment's place. A Hausman test compares both
    answers.

    Parameters
    ----------
    matches : of `match_segments`.
    segments : those that the matches number.
    rig : the cameras that they were matched with.
    pictures : for each view of `matches` its picture, as `find_segments` takes it.
    response : how the cameras make grey levels of light, as in `find_segments`.
    tuning : every tuned constant.

    Returns
    -------
    The same tracks. `measure` says which view rests on its pixels, or why it does not. Lines,
    fragments, their covariances and `misfit` follow; ends keep their places along the lines.

    Raises
    ------
    InputError : views without a picture or segments, pictures of another size than their camera's.

    Source of the test: J. A. Hausman, "Specification tests in econometrics", 1978,
    doi:10.2307/1913827.
    """
    check_pictures("Measuring lines", matches.views, rig, pictures)
    given = segments_of_views("Measuring lines", matches.views, segments)
    images, views = [], []
    for view, name in enumerate(matches.views):
        own = given[name]
        lens = rig[name].intrinsics
        seen = line_images(matches, view, own, np.asarray(rig[name].matrix_px), lens)
        light = Light.from_picture(pictures[name], response)
        every = np.asarray(own.endpoints_px, dtype=np.float64)
        images.append(seen)
        views.append(fit_view(light, every, lens, seen, tuning))
    return apply_measurements(matches, rig, images, views, tuning)


# numerical: Gauss-Newton steps, which converge.
_STEPS = 4


class PixelLineFit(NamedTuple):
    """Fields
    ------
    move_mm : (t, 4) of the first end, then of the last, along the two axes across the line.
    covariance_mm2 : (t, 4, 4) of these, NaN of lines that the views do not determine.
    misfit : (t,) chi-square by which the views disagree.
    """

    move_mm: Float[np.ndarray, "t 4"]
    covariance_mm2: Float[np.ndarray, "t 4 4"]
    misfit: Float[np.ndarray, "t"]


def fit_lines_to_pixels(
    matrices_px: Float[np.ndarray, "v 3 4"],
    ends_mm: Float[np.ndarray, "t 2 3"],
    axes: Float[np.ndarray, "t 2 3"],
    places_px: Float[np.ndarray, "t v 2 2"],
    covariance_px2: Float[np.ndarray, "t v 2 2"],
    seen: Float[np.ndarray, "t v"],
) -> PixelLineFit:
    """Lines whose images go through places, known to this across; views that see none count 0."""
    count = len(ends_mm)
    matrices = np.broadcast_to(matrices_px, (count, *matrices_px.shape))
    white = whitening(covariance_px2)

    def move_across(move: Float[np.ndarray, "t 4"]) -> Float[np.ndarray, "t 2 3"]:
        return ends_mm + move.reshape(count, 2, 2) @ axes

    def residuals(move: Float[np.ndarray, "t 4"]) -> Residuals:
        found = distances_from_line(matrices, move_across(move)[:, None], places_px)
        by_move = np.einsum("tvpei,tai->tvpea", found.by_ends, axes).reshape(*white.shape[:3], 4)
        distance = (white @ found.distance_px[..., None])[..., 0]
        return Residuals(distance, white @ by_move, seen)

    move, equations = gauss_newton(residuals, np.add, np.zeros((count, 4)), steps=_STEPS)
    return PixelLineFit(move, equations.covariance(), equations.chi_square)


DISAGREES = "disagrees"
# numerical: a line has four.
_UNKNOWNS = 4


def apply_measurements(
    matches: Matches,
    rig: Rig,
    images: Sequence[LineImages],
    views: Sequence[ViewFit],
    tuning: PixelTuning,
) -> Matches:
    """Matches whose lines and fragments rest on pixels where these hold."""
    tracks, sides = matches.index.shape
    words = np.full((tracks, sides), "", dtype="<U16")
    place = np.zeros((tracks, sides, 2, 2))
    place[..., 0, :] = 1.0
    covariance = np.tile(np.eye(2), (tracks, sides, 1, 1))
    for view, (seen, fit) in enumerate(zip(images, views, strict=True)):
        rows = seen.track
        words[rows, view] = fit.words
        place[rows, view] = seen.ends_px + fit.offset_px[..., None] * seen.right[:, None]
        covariance[rows, view] = fit.covariance_px2
    way = matches.lines_mm[:, 1] - matches.lines_mm[:, 0]
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    axes = complete_axes(unit)
    matrices = np.stack([np.asarray(rig[name].matrix_px) for name in matches.views])
    seen = matches.index >= 0
    found = fit_lines_to_pixels(
        matrices, matches.lines_mm, axes, place, covariance, seen.astype(np.float64)
    )
    sound = np.asarray(np.isfinite(found.covariance_mm2).all(axis=(1, 2)))
    move = np.where(sound[:, None], found.move_mm, 0.0)
    spread = np.where(sound[:, None, None], found.covariance_mm2, np.eye(_UNKNOWNS))
    misfit = np.where(sound, found.misfit, 0.0)
    sound &= (words == PIXELS).any(axis=1)

    # Both answers in coordinates across both ends and along the line.
    turn = np.zeros((tracks, 6, 6))
    turn[:, 0:2, 0:3] = turn[:, 2:4, 3:6] = axes
    turn[:, 4, 0:3] = turn[:, 5, 3:6] = unit
    before = turn @ matches.covariance_mm2 @ turn.mT
    freedom = degrees_of_misfit(matches.index)
    sure = sound & (freedom > 0) & (matches.posterior > tuning.sure)
    rules = NoiseTuning(tail_of_pictures=tuning.tail)
    tail = fit_tail(misfit[sure], freedom[sure], has_images=True, tuning=rules)
    spread = spread * variance_factor(misfit, freedom, tail)[:, None, None]
    difference = hausman(move, before[:, :4, :4], spread, tuning.least_difference)
    limit = chi_square_limit(tuning.least_probability, _UNKNOWNS)
    # Where the answers differ too much, the pixels' holds if its views agree among themselves, as
    # two always do: segments are off more often than pixels. Its covariance then covers both.
    three = seen.sum(axis=1) > 2
    agree = chi_square_tail(misfit, np.maximum(freedom, 1)) > tuning.least_probability
    holds = sound & ((difference <= limit) | agree)
    spread = spread * np.maximum(difference / limit, 1.0)[:, None, None]
    ends, of_ends = _move_lines(matches.lines_mm, turn, before, move, spread)
    depth = np.einsum("vj,tej->tve", matrices[:, 2, :3], ends) + matrices[:, 2, 3][:, None]
    holds &= ((depth > 0).all(axis=2) | ~seen).all(axis=1) & np.isfinite(ends).all(axis=(1, 2))
    words = np.where((words == PIXELS) & ~holds[:, None], DISAGREES, words)
    fragments, of_fragments = _fragments(matches, rig, images, views, words)
    counts = {
        "measured: lines by their pixels": int(holds.sum()),
        "measured: lines by their segments": int((~holds).sum()),
    }
    measured = dataclasses.replace(
        matches,
        fragments_px=fragments,
        lines_mm=np.where(holds[:, None, None], ends, matches.lines_mm),
        covariance_mm2=np.where(holds[:, None, None], of_ends, matches.covariance_mm2),
        counts=matches.counts | counts,
        fragments_covariance_px2=of_fragments,
        rig_covariance_mm2=None,
        misfit=None if matches.misfit is None else np.where(holds & three, misfit, matches.misfit),
    )
    return measured.with_marks(measure=words)


def hausman(
    difference: Float[np.ndarray, "t k"],
    usual: Float[np.ndarray, "t k k"],
    efficient: Float[np.ndarray, "t k k"],
    least: float,
) -> Float[np.ndarray, "t"]:
    """Chi-square, with k degrees of freedom, of the difference of two answers to one question.

    Its covariance is the difference of theirs, if one of them is efficient; where that is not
    positive, or small, it is `least` of the efficient one's.
    """
    root = np.linalg.cholesky(efficient)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ usual @ inverse.mT)
    along = (vectors.mT @ inverse @ difference[..., None])[..., 0]
    return (along**2 / np.maximum(values - 1, least)).sum(axis=1)


def _move_lines(
    ends_mm: Float[np.ndarray, "t 2 3"],
    turn: Float[np.ndarray, "t 6 6"],
    before: Float[np.ndarray, "t 6 6"],
    move: Float[np.ndarray, "t 4"],
    spread: Float[np.ndarray, "t 4 4"],
) -> tuple[np.ndarray, np.ndarray]:
    """(ends, covariance) after lines moved across: along, ends follow as they did before."""
    follow = np.linalg.solve(before[:, :4, :4], before[:, :4, 4:]).mT
    along = (follow @ move[..., None])[..., 0]
    own = before[:, 4:, 4:] - follow @ before[:, :4, 4:]
    both = follow @ spread
    after = np.zeros_like(before)
    after[:, :4, :4], after[:, 4:, :4], after[:, :4, 4:] = spread, both, both.mT
    after[:, 4:, 4:] = own + both @ follow.mT
    step = (turn.mT @ np.concatenate([move, along], axis=1)[..., None])[..., 0]
    return ends_mm + step.reshape(-1, 2, 3), turn.mT @ after @ turn


def _fragments(
    matches: Matches,
    rig: Rig,
    images: Sequence[LineImages],
    views: Sequence[ViewFit],
    words: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Fragments on the images of lines that their pixels show, with covariance."""
    fragments, covariance = matches.fragments_px.copy(), None
    if matches.fragments_covariance_px2 is not None:
        covariance = matches.fragments_covariance_px2.copy()
    for view, (seen, fit) in enumerate(zip(images, views, strict=True)):
        lens, rows = rig[matches.views[view]].intrinsics, seen.track
        good = words[rows, view] == PIXELS
        flat = undistort_pixels(lens, matches.fragments_px[rows, view])
        along = np.einsum("sei,si->se", flat - seen.ends_px[:, :1], seen.way)
        share = along / seen.length_px[:, None]
        across = interpolate_offset(fit.offset_px, share)
        place = seen.ends_px[:, :1] + along[..., None] * seen.way[:, None]
        place = distort_pixels(lens, place + across[..., None] * seen.right[:, None])
        # A part that is moved across may end beyond the fold of the lens: it stays as it was.
        inside = good & np.isfinite(place).all(axis=(1, 2))
        fragments[rows[inside], view] = place[inside]
        if covariance is None:
            continue
        weight = np.stack([1 - share, share], axis=2)
        spread = np.where(
            good[:, None, None],
            weight @ fit.covariance_px2 @ weight.mT,
            fit.widened_px2[:, None, None] * np.ones((2, 2)),
        )
        added = np.einsum("sef,si,sj->seifj", spread, seen.right, seen.right).reshape(-1, 4, 4)
        beside = np.einsum("ef,si,sj->seifj", np.eye(2), seen.way, seen.way).reshape(-1, 4, 4)
        old = covariance[rows, view]
        kept = np.where(good[:, None, None], beside @ old @ beside, old)
        covariance[rows, view] = kept + added
    return fragments, covariance
