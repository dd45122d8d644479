"""From matches to rims: circles that two matched lines suggest, those first for which other lines
speak, fitted and chosen."""

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
    collect_chords,
    fit_circle,
    image_circles,
    off_circles,
    touching,
    usual_mm_per_px,
)
from trinoc.match.rims.rim_answer import (
    Arcs,
    FittedRim,
    RimChoice,
    build_rims,
    cover_circle,
    share_of_two_views,
)
from trinoc.match.rims.rim_support import about, has_rival, sum_support, supports
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import cross_3d

# Of the circles of most support so many are fitted before the best is chosen.
# numerical: a block size.
_AT_ONCE = 6
# While it is fitted, a circle's image moves by less than this.
# numerical: a margin for time: only what lies nearer is fitted.
_ROOM_PX = 15.0


@in_float64
def find_rims(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    tuning: MatchTuning = DEFAULT,
) -> Rims:
    """Circles in space whose arcs the views show in chords, such as rims of cylinders.

    Chords of one arc are cut at other places in every view, so that matched chords are near the
    arc, and not on it. All chords of a rim, in all views, leave six numbers: its centre, its plane
    and its radius. Circles are suggested by pairs of matched lines, judged by the segments of all
    views, and put out where chords of two views show more than a quarter. Tracks of their chords
    are replaced by pieces of the circle, cut where segments end; tracks of the body's outlines
    below a rim have the mark "silhouette".

    Parameters
    ----------
    matches : of `match_segments`.
    segments : those that were matched, found with `arcs=True`: else there are hardly any chords.
    rig : the cameras that they were matched with, which count as exact.
    tuning : every tuned constant; `rims` are those of this function.

    Raises
    ------
    InputError : views of the matches without segments.
    """
    stated = prepare(segments_of_views("Finding rims", matches.views, segments), rig, None)
    # Matched chords disagree: what that makes of their errors is none of the rims'.
    chords = collect_chords(stated, matches.views)
    seen = with_noise_scale(stated, np.array([matches.noise_scale]))
    scale = usual_mm_per_px(matches.lines_mm, rig, matches.views)
    cameras = np.asarray(stated.frames[0].cameras.matrix_px)
    start = propose_rims(matches.lines_mm, cameras, tuning.rims)
    chosen = _choose_rims(chords, start, tuning.rims)
    return build_rims(matches, seen, chords, chosen, scale, tuning.rims)


def _choose_rims(chords: Chords, start: Circles, tuning: RimTuning) -> RimChoice:
    """Rims, one after the other, those of the longest chords first; a chord belongs to one."""
    support = supports(chords, start, 2 * tuning.touch_px, tuning)
    ones = np.ones_like(support.data)
    touches = csr_array((ones, support.indices, support.indptr), support.shape)
    views = int(chords.view.max(initial=-1)) + 1
    by_view = (chords.view[:, None] == np.arange(views)).astype(np.float64)
    free, found, ambiguous = np.ones(len(chords.view), dtype=bool), [], 0
    left = np.ones(len(start.radius_mm), dtype=bool)
    while True:
        # Some of a circle's chords lie further off before it is fitted.
        number = touches @ (by_view * free[:, None]) >= tuning.least_chords - 1
        total = np.where(left & (number.sum(axis=1) >= 2), support @ free.astype(np.float64), 0.0)
        tried = np.argsort(-total, kind="stable")[:_AT_ONCE]
        tried = tried[total[tried] > 0]
        if len(tried) == 0:
            return RimChoice(found, ambiguous)
        best = None
        for row in tried:
            rim = _fit_rim(chords, take_rows(start, row[None]), free, views, tuning)
            if rim is None:
                # Nor will it be one later, since chords are taken and never given back.
                left[row] = False
            elif best is None or rim.support > best.support:
                best = rim
        if best is None:
            continue
        free[best.own] = False
        if best.of_two and has_rival(chords, best.circle, best.own, tuning):
            ambiguous += 1
        else:
            found.append(best)


def _fit_rim(
    chords: Chords, circle: Circles, free: Bool[np.ndarray, "n"], views: int, tuning: RimTuning
) -> FittedRim | None:
    """The rim near a circle; None where too little touches it."""
    rows = np.flatnonzero(about(chords, circle, _ROOM_PX)[0] & free)
    chords = take_rows(chords, rows)
    touch = tuning.touch_px
    first = _circle_evidence(chords, circle, 2 * touch, views, tuning)
    if first.covered < tuning.least_covered / 2:
        return None
    covariance = np.zeros((6, 6))
    for within in (2 * touch, 1.5 * touch, touch, touch):
        own = np.flatnonzero(touching(off_circles(chords, circle), within, tuning)[0])
        if np.sort(np.bincount(chords.view[own], minlength=views))[-2] < tuning.least_chords:
            return None
        circle, covariance = fit_circle(take_rows(chords, own), circle)
    last = _circle_evidence(chords, circle, touch, views, tuning)
    number = np.bincount(chords.view[last.own], minlength=views)
    # Two arcs of two views leave three numbers each, place, direction and bend, as many as a circle
    # takes: they always lie on one, unless they are long.
    of_two = np.count_nonzero(number) == 2
    least = tuning.least_covered * (2 if of_two else 1)
    if np.sort(number)[-2] < tuning.least_chords or last.covered < least:
        return None
    if not np.isfinite(covariance).all():
        return None
    own, arcs, covered, support = last
    return FittedRim(circle, covariance, rows[own], arcs, covered, support, of_two)


class _CircleEvidence(NamedTuple):
    """What chords show of a circle. support : in all."""

    own: Int[np.ndarray, "k"]
    arcs: Arcs
    covered: float
    support: float


def _circle_evidence(
    chords: Chords, circle: Circles, within_px: float, views: int, tuning: RimTuning
) -> _CircleEvidence:
    off = off_circles(chords, circle, with_ends=True)
    support = sum_support(chords, off, within_px, tuning)[0]
    own = np.flatnonzero(support > 0)
    arcs = cover_circle(off.around_mm[0, own], circle)
    covered = share_of_two_views(arcs, chords.view[own], views)
    return _CircleEvidence(own, arcs, covered, float(support.sum()))


# numerical: lines that are held against circles at once: for memory, some 100 bytes each.
MOST_AT_ONCE = 1 << 21
# numerical: for time: of each line so many nearest others are tried with it, and so many circles
# kept, and so many in all: measured scenes have fewer.
MOST_NEIGHBOURS, MOST_OF_LINE, MOST_CIRCLES = 150, 6, 1500


def propose_rims(
    lines_mm: Float[np.ndarray, "t 2 3"],
    cameras_px: Float[np.ndarray, "v 3 4"],
    tuning: RimTuning,
) -> Circles:
    """Circles that touch two lines each at their middles and that two cameras at least do not see
    edge-on, the best supported ones."""
    middle = lines_mm.mean(axis=1)
    way = lines_mm[:, 1] - lines_mm[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / np.maximum(length, 1e-12)[:, None]
    one, other = _neighbours(middle, MOST_NEIGHBOURS)
    normal = cross_3d(unit[one], unit[other])
    sine = np.linalg.norm(normal, axis=1)
    turned = sine > np.sin(np.radians(tuning.tangent_deg))
    one, other, normal = one[turned], other[turned], normal[turned] / sine[turned, None]
    step = middle[other] - middle[one]
    inward = [cross_3d(normal, unit[own]) for own in (one, other)]
    found = []
    # Both touch from the same side of their directions, or from opposite ones.
    for side in (1.0, -1.0):
        between = inward[0] - side * inward[1]
        reach = (between * step).sum(axis=1) / np.maximum((between**2).sum(axis=1), 1e-12)
        open_mm = np.linalg.norm(step - reach[:, None] * between, axis=1)
        radius = np.abs(reach)
        # Each line is a chord, shorter than the circle is wide.
        wide = radius > np.maximum(length[one], length[other]) / 2
        good = (open_mm < tuning.closes_share * radius) & wide
        centre = (middle[one] + middle[other]) / 2
        centre = centre + reach[:, None] * (inward[0] + side * inward[1]) / 2
        found.append((one[good], Circles(centre[good], normal[good], radius[good])))
    line, circles = concatenate_rows(found)
    ratios = np.stack([image_circles(circles, camera).axis_ratio for camera in cameras_px])
    opened = np.flatnonzero((ratios > tuning.least_axis_ratio).sum(axis=0) >= 2)
    line, circles = line[opened], take_rows(circles, opened)
    support = np.zeros(len(line))
    for part in blocks(len(line), max(MOST_AT_ONCE // max(len(lines_mm), 1), 1)):
        some = Circles(*(column[part] for column in circles))
        support[part] = _support(some, middle, unit, length, tuning)
    # The best of each line, so that one rim of many chords does not hide another.
    best = np.lexsort((-support, line))
    rank = np.arange(len(best)) - np.searchsorted(line[best], line[best])
    best = best[rank < MOST_OF_LINE]
    best = best[np.argsort(-support[best], kind="stable")[:MOST_CIRCLES]]
    return take_rows(circles, best)


def _neighbours(
    middle_mm: Float[np.ndarray, "t 3"], most: int
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Pairs of lines, each with the nearest so many others."""
    count = len(middle_mm)
    if count <= most + 1:
        return np.triu_indices(count, 1)
    near = np.asarray(KDTree(middle_mm).query(middle_mm, most + 1)[1])
    pairs = np.stack([np.repeat(np.arange(count), most + 1), near.ravel()], axis=1)
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
    """Length of the lines that lie on each circle, as far as lines in space are known."""
    centre, normal, radius = circles
    height = normal @ middle_mm.T - (normal * centre).sum(axis=1)[:, None]
    square = (middle_mm**2).sum(axis=1) - 2 * centre @ middle_mm.T
    square = square + (centre**2).sum(axis=1)[:, None]
    distance = np.sqrt(np.maximum(square - height**2, 1e-12))
    out_of_plane = normal @ unit.T
    radial = (middle_mm * unit).sum(axis=1) - centre @ unit.T - height * out_of_plane
    alike = np.sin(np.radians(tuning.tangent_deg))
    near = (tuning.closes_share * radius / 2)[:, None]
    on = (np.abs(height) < near) & (np.abs(distance - radius[:, None]) < near)
    on &= (np.abs(out_of_plane) < alike) & (np.abs(radial) < alike * distance)
    return on @ length_mm
