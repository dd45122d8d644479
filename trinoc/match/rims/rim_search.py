"""Search for rims: circles proposed by pairs of matched lines, ranked by the support of other
lines, and fitted.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.observations.match_input import prepare, with_noise_scale
from trinoc.match.observations.pictures_of_views import segments_of_views
from trinoc.match.rims.circles import (
    Chords,
    Circles,
    are_touching,
    circle_offsets,
    collect_chords,
    fit_circle,
    image_circles,
    usual_mm_per_px,
)
from trinoc.match.rims.rim_answer import (
    Arcs,
    FittedRim,
    RimChoice,
    build_rims,
    cover_circle,
    share_in_two_views,
)
from trinoc.match.rims.rim_support import are_near_images, has_rival, sum_support, support_matrix
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import cross_3d

# numerical: number of circles with the largest support that are fitted before one is accepted.
_FITS_PER_ROUND = 6
# numerical: margin about a circle's image, px, that limits the chords of a fit, for time. The image
# moves less than this during the fit.
_MARGIN_PX = 15.0


@in_float64
def find_rims(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    tuning: MatchTuning = DEFAULT,
) -> Rims:
    """Detect circles in space whose arcs the views show as chords, such as rims of cylinders.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments`.
    segments : mapping
        The matched segments of each view, detected with `arcs=True`. Otherwise there are hardly any
        chords.
    rig : Rig
        The cameras of the matches, which are assumed exact.
    tuning : MatchTuning
        Tuned constants; the group `rims` is used here.

    Returns
    -------
    Rims
        The circles, their chords, and the matches with pieces of the circles.

    Raises
    ------
    InputError
        If a view of the matches has no segments.

    Notes
    -----
    Each view divides an arc into chords at other positions. Matched chords are therefore near the
    arc and not on it. A rim has six unknowns: centre, plane and radius. All chords of the rim in
    all views determine these unknowns.

    Pairs of matched lines propose circles. The segments of all views are compared with each circle.
    A circle is accepted if two views have chords on more than a quarter of the circle. Pieces of
    the circle, cut where segments end, replace the tracks of its chords. Tracks of the body's
    outlines below a rim get the mark "silhouette".
    """
    inputs = prepare(segments_of_views("Finding rims", matches.views, segments), rig, None)
    # The noise scale of the matches is not used here, because matched chords disagree.
    chords = collect_chords(inputs, matches.views)
    scaled_inputs = with_noise_scale(inputs, np.array([matches.noise_scale]))
    scale = usual_mm_per_px(matches.lines_mm, rig, matches.views)
    cameras = np.asarray(inputs.frames[0].cameras.matrix_px)
    proposals = propose_rims(matches.lines_mm, cameras, tuning.rims)
    choice = _choose_rims(chords, proposals, tuning.rims)
    return build_rims(matches, scaled_inputs, chords, choice, scale, tuning.rims)


def _choose_rims(chords: Chords, start: Circles, tuning: RimTuning) -> RimChoice:
    """Accept rims one by one, those with the longest chords first. A chord belongs to at most one
    rim.

    `start` are the proposed circles.
    """
    support = support_matrix(chords, start, 2 * tuning.touch_px, tuning)
    unit_entries = np.ones_like(support.data)
    incidence = csr_array((unit_entries, support.indices, support.indptr), support.shape)
    views = int(chords.view.max(initial=-1)) + 1
    by_view = (chords.view[:, None] == np.arange(views)).astype(np.float64)
    is_free, rims, ambiguous = np.ones(len(chords.view), dtype=bool), [], 0
    is_open = np.ones(len(start.radius_mm), dtype=bool)
    while True:
        # Before the fit, some chords lie outside the limit, so one less is required.
        has_enough = incidence @ (by_view * is_free[:, None]) >= tuning.min_chords - 1
        free_support = np.where(
            is_open & (has_enough.sum(axis=1) >= 2), support @ is_free.astype(np.float64), 0.0
        )
        rows = np.argsort(-free_support, kind="stable")[:_FITS_PER_ROUND]
        rows = rows[free_support[rows] > 0]
        if len(rows) == 0:
            return RimChoice(rims, ambiguous)
        best = None
        for row in rows:
            rim = _fit_rim(chords, take_rows(start, row[None]), is_free, views, tuning)
            if rim is None:
                # It will not become one later, because the number of free chords only decreases.
                is_open[row] = False
            elif best is None or rim.support > best.support:
                best = rim
        if best is None:
            continue
        is_free[best.chord_rows] = False
        if best.only_two_views and has_rival(chords, best.circle, best.chord_rows, tuning):
            ambiguous += 1
        else:
            rims.append(best)


def _fit_rim(
    chords: Chords, circle: Circles, is_free: Bool[np.ndarray, "n"], views: int, tuning: RimTuning
) -> FittedRim | None:
    """Fit a rim to the free chords near a proposed circle; None if too few chords lie on it.

    `is_free` marks the chords that belong to no other rim. `views` is the number of views.
    """
    rows = np.flatnonzero(are_near_images(chords, circle, _MARGIN_PX)[0] & is_free)
    chords = take_rows(chords, rows)
    limit_px = tuning.touch_px
    before = _circle_evidence(chords, circle, 2 * limit_px, views, tuning)
    if before.covered_share < tuning.min_covered_share / 2:
        return None
    covariance = np.zeros((6, 6))
    for current_limit_px in (2 * limit_px, 1.5 * limit_px, limit_px, limit_px):
        chord_rows = np.flatnonzero(
            are_touching(circle_offsets(chords, circle), current_limit_px, tuning)[0]
        )
        if np.sort(np.bincount(chords.view[chord_rows], minlength=views))[-2] < tuning.min_chords:
            return None
        circle, covariance = fit_circle(take_rows(chords, chord_rows), circle)
    after = _circle_evidence(chords, circle, limit_px, views, tuning)
    chords_per_view = np.bincount(chords.view[after.chord_rows], minlength=views)
    # Two arcs in two views have three parameters each: position, direction and curvature. A circle
    # has six, so short arcs always fit one.
    only_two_views = np.count_nonzero(chords_per_view) == 2
    smallest_share = tuning.min_covered_share * (2 if only_two_views else 1)
    if np.sort(chords_per_view)[-2] < tuning.min_chords or after.covered_share < smallest_share:
        return None
    if not np.isfinite(covariance).all():
        return None
    chord_rows, arcs, covered_share, support = after
    return FittedRim(
        circle, covariance, rows[chord_rows], arcs, covered_share, support, only_two_views
    )


class _CircleEvidence(NamedTuple):
    """Chords of one circle.

    Attributes
    ----------
    chord_rows : (k,)
        Rows of the chords in `Chords`.
    arcs : Arcs
        Arc that each chord covers.
    covered_share : float
        Share of the circle that two or more views show.
    support : float
        Total length of the chords, px, weighted by their distance from the circle.
    """

    chord_rows: Int[np.ndarray, "k"]
    arcs: Arcs
    covered_share: float
    support: float


def _circle_evidence(
    chords: Chords, circle: Circles, limit_px: float, views: int, tuning: RimTuning
) -> _CircleEvidence:
    offsets = circle_offsets(chords, circle, with_ends=True)
    support = sum_support(chords, offsets, limit_px, tuning)[0]
    chord_rows = np.flatnonzero(support > 0)
    arcs = cover_circle(offsets.nearest_mm[0, chord_rows], circle)
    covered_share = share_in_two_views(arcs, chords.view[chord_rows], views)
    return _CircleEvidence(chord_rows, arcs, covered_share, float(support.sum()))


# numerical: number of pairs (line, circle) in memory, about 100 bytes each.
ENTRIES_AT_A_TIME = 1 << 21
# numerical: limits for time: neighbours of each line, circles of each line, circles in all.
# Measured scenes have fewer.
MAX_NEIGHBOURS, MAX_CIRCLES_PER_LINE, MAX_CIRCLES = 150, 6, 1500


def propose_rims(
    lines_mm: Float[np.ndarray, "t 2 3"],
    cameras_px: Float[np.ndarray, "v 3 4"],
    tuning: RimTuning,
) -> Circles:
    """Return the circles to which two matched lines are tangent at their midpoints.

    Only the circles with the largest total length of such lines are returned. At least two cameras
    see each circle not edge-on.
    """
    middle = lines_mm.mean(axis=1)
    step = lines_mm[:, 1] - lines_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(length, 1e-12)[:, None]
    first, second = _neighbour_pairs(middle, MAX_NEIGHBOURS)
    normal = cross_3d(unit[first], unit[second])
    sine = np.linalg.norm(normal, axis=1)
    is_turned = sine > np.sin(np.radians(tuning.tangent_deg))
    first = first[is_turned]
    second = second[is_turned]
    normal = normal[is_turned] / sine[is_turned, None]
    between_middles = middle[second] - middle[first]
    inward = [cross_3d(normal, unit[line_rows]) for line_rows in (first, second)]
    proposals = []
    # The circle lies on the same side of both directions, or on opposite sides.
    for side in (1.0, -1.0):
        difference = inward[0] - side * inward[1]
        signed_radius = (difference * between_middles).sum(axis=1) / np.maximum(
            (difference**2).sum(axis=1), 1e-12
        )
        closure_mm = np.linalg.norm(between_middles - signed_radius[:, None] * difference, axis=1)
        radius = np.abs(signed_radius)
        # A chord is shorter than the diameter of its circle.
        is_wide = radius > np.maximum(length[first], length[second]) / 2
        is_valid = (closure_mm < tuning.closure_share * radius) & is_wide
        centre = (middle[first] + middle[second]) / 2
        centre = centre + signed_radius[:, None] * (inward[0] + side * inward[1]) / 2
        proposals.append(
            (first[is_valid], Circles(centre[is_valid], normal[is_valid], radius[is_valid]))
        )
    line, circles = concatenate_rows(proposals)
    ratios = np.stack([image_circles(circles, camera).axis_ratio for camera in cameras_px])
    visible_rows = np.flatnonzero((ratios > tuning.min_axis_ratio).sum(axis=0) >= 2)
    line, circles = line[visible_rows], take_rows(circles, visible_rows)
    support = np.zeros(len(line))
    for part in blocks(len(line), max(ENTRIES_AT_A_TIME // max(len(lines_mm), 1), 1)):
        block = Circles(*(column[part] for column in circles))
        support[part] = _support(block, middle, unit, length, tuning)
    # Only the best circles of each line, so that a rim with many chords does not displace others.
    order = np.lexsort((-support, line))
    rank = np.arange(len(order)) - np.searchsorted(line[order], line[order])
    order = order[rank < MAX_CIRCLES_PER_LINE]
    order = order[np.argsort(-support[order], kind="stable")[:MAX_CIRCLES]]
    return take_rows(circles, order)


def _neighbour_pairs(
    middle_mm: Float[np.ndarray, "t 3"], limit: int
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Return the pairs of each line with its `limit` nearest lines, as two arrays of indices."""
    count = len(middle_mm)
    if count <= limit + 1:
        return np.triu_indices(count, 1)
    nearest = np.asarray(KDTree(middle_mm).query(middle_mm, limit + 1)[1])
    pairs = np.stack([np.repeat(np.arange(count), limit + 1), nearest.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    first, second = pairs[pairs[:, 0] < pairs[:, 1]].T
    return first, second


def _support(
    circles: Circles,
    middle_mm: Float[np.ndarray, "t 3"],
    unit: Float[np.ndarray, "t 3"],
    length_mm: Float[np.ndarray, "t"],
    tuning: RimTuning,
) -> Float[np.ndarray, "h"]:
    """Return the total length of the lines in space that are tangent to each circle, (h,) mm.

    `middle_mm`, `unit` and `length_mm` are midpoint, direction and length of the lines.
    """
    centre, normal, radius = circles
    height = normal @ middle_mm.T - (normal * centre).sum(axis=1)[:, None]
    square = (middle_mm**2).sum(axis=1) - 2 * centre @ middle_mm.T
    square = square + (centre**2).sum(axis=1)[:, None]
    distance = np.sqrt(np.maximum(square - height**2, 1e-12))
    out_of_plane = normal @ unit.T
    radial = (middle_mm * unit).sum(axis=1) - centre @ unit.T - height * out_of_plane
    largest_sine = np.sin(np.radians(tuning.tangent_deg))
    limit_mm = (tuning.closure_share * radius / 2)[:, None]
    is_on_circle = (np.abs(height) < limit_mm) & (np.abs(distance - radius[:, None]) < limit_mm)
    is_on_circle &= (np.abs(out_of_plane) < largest_sine) & (
        np.abs(radial) < largest_sine * distance
    )
    return is_on_circle @ length_mm
