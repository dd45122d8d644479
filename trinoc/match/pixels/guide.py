"""Guided detection: every picture is asked again where matched lines must be."""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Shaped

from trinoc.geometry.intrinsics import distort_pixels
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.observations.pictures_of_views import check_pictures, segments_of_views
from trinoc.match.pixels.new_lines import with_new_lines
from trinoc.match.pixels.prolong import prolong_segments
from trinoc.match.pixels.state import State, build_tables, ends_are_swapped, initial_state
from trinoc.match.pixels.views import PictureInput, picture_inputs, with_usual_width
from trinoc.match.tracks.answers import MATCHED
from trinoc.match.tracks.assembly import flag_viewpoint_dependent
from trinoc.match.tracks.line_fit import (
    common_ends,
    cut_fragments,
    ending_view,
    track_intervals,
)
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tracks.unequal_errors import (
    degrees_of_misfit,
    scale_covariance_of_lines,
    variance_factor,
)
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.guided import GuidedTuning
from trinoc.numerics.precision import ArrayLike, in_float64


class GuidedMatches(eqx.Module):
    """Matches after every picture was asked again, and the segments that they number.

    Fields
    ------
    segments : of each view, those that were given, in their order, some of them longer, and after
        them those that were added.
    matches : the tracks that were given, in their order, and after them new ones; `guided` says
        which fragments rest on guided detection.
    """

    segments: dict[str, Segments]
    matches: Matches


@in_float64
def guide_matches(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    pictures: Mapping[str, Shaped[np.ndarray, "..."]],
    *,
    tuning: MatchTuning = DEFAULT,
) -> GuidedMatches:
    """Ask every picture again where matched lines must be, and add what it shows there.

    A search for edges in one picture has millions of places to be wrong at, and must ask for much.
    Along a known line there is one: the picture is asked for an edge at this place and in this
    direction, with a rate of false alarms for these few tests. Asked for are what lies
    beyond the ends of matched segments, and lines that may be there: from a corner parallel to a
    line beside it.

    Parameters
    ----------
    matches : of `match_segments`.
    segments : those that were matched.
    rig : the cameras that they were matched with.
    pictures : for each view of `matches` its picture, as `find_segments` takes it.
    tuning : every tuned constant; `guided` are those of this function.

    Raises
    ------
    InputError : views without a picture or segments, pictures of another size than their camera's.
    """
    check_pictures("Guided detection", matches.views, rig, pictures)
    given = segments_of_views("Guided detection", matches.views, segments)
    inputs = picture_inputs(rig, {name: pictures[name] for name in matches.views})
    before = initial_state(matches, given, rig)
    inputs = [
        with_usual_width(picture, shown.ends_px)
        for picture, shown in zip(inputs, before.segments, strict=True)
    ]
    after, added = rounds(before, inputs, tuning.guided)
    tables = collect_segments(before, after, given)
    return GuidedMatches(tables, join_matches(after, matches, added, tuning))


def rounds(
    state: State, pictures: list[PictureInput], tuning: GuidedTuning
) -> tuple[State, dict[str, int]]:
    """(the state when nothing more is added, how much was added of each kind)."""
    total = np.zeros(2, dtype=np.int64)
    for _ in range(tuning.rounds):
        state, new = with_new_lines(state, pictures, tuning)
        state, longer = prolong_segments(state, pictures, tuning)
        total += [new, longer]
        if new + longer == 0:
            break
    words = "guided: new tracks", "guided: segments lengthened"
    return state, dict(zip(words, total.tolist(), strict=True))


def collect_segments(
    before: State, after: State, given: dict[str, Segments]
) -> dict[str, Segments]:
    """The segments of each view: those that were given, some longer, and those that were added."""
    return {
        name: _of_view(before, after, view, given[name]) for view, name in enumerate(after.names)
    }


def _of_view(before: State, after: State, view: int, given: Segments) -> Segments:
    old, now = before.segments[view], after.segments[view]
    count = len(given)
    changed = np.flatnonzero(now.guided[:count])
    lens = after.cameras.intrinsics[view]
    if len(changed) == 0 and len(now.ends_px) == count:
        return given
    ends, covariance = distort_pixels(lens, now.ends_px), now.covariance_px2
    back = ends_are_swapped(old.ends_px, lens, given)
    turn = np.concatenate([back, np.zeros(len(now.ends_px) - count, dtype=bool)])
    ends = np.where(turn[:, None, None], ends[:, ::-1], ends)
    blocks = covariance.reshape(-1, 2, 2, 2, 2)
    blocks = np.where(turn[:, None, None, None, None], blocks[:, ::-1, :, ::-1], blocks)
    covariance = blocks.reshape(-1, 4, 4)
    keep = np.ones(len(ends), dtype=bool)
    keep[changed] = keep[count:] = False
    keep = keep[:count]
    height = now.contrast[len(old.contrast) :]
    longer = dataclasses.replace(
        given, endpoints_px=ends[:count], covariance_px2=covariance[:count]
    )
    added = Segments(
        ends[count:],
        covariance[count:],
        -np.sign(height).astype(np.int64),
        np.abs(height),
        np.zeros(len(height), dtype=np.int64),
        given.image_size_px,
    )
    return longer.append(added)


def join_matches(
    after: State, given: Matches, added: dict[str, int], tuning: MatchTuning
) -> Matches:
    """The given tracks, in their order, and after them the new ones."""
    tracks = after.tracks
    if len(tracks.index) == 0:
        return dataclasses.replace(given, counts=given.counts | added)
    seen = build_tables(after)
    common = common_ends(seen, tracks.index, tracks.ends_mm)
    here = ending_view(seen, tracks.index, common)
    interval = track_intervals(seen, tracks.index, common)
    fragments, covariance = cut_fragments(seen, tracks.index, interval, here)
    guided = np.zeros(tracks.index.shape, dtype=bool)
    for view, own in enumerate(after.segments):
        on = np.flatnonzero(tracks.index[:, view] >= 0)
        guided[on, view] = own.guided[tracks.index[on, view]]
        fragments[on, view] = distort_pixels(after.cameras.intrinsics[view], fragments[on, view])
    new = len(tracks.index) - len(given)
    views = (tracks.index >= 0).sum(axis=1)
    factor = variance_factor(tracks.misfit, degrees_of_misfit(tracks.index), given.noise_tail)
    return Matches(
        given.views,
        tracks.index,
        fragments,
        tracks.ends_mm,
        scale_covariance_of_lines(tracks.ends_mm, tracks.covariance_mm2, factor),
        np.where(views > 2, TRINOCULAR, BINOCULAR),
        1 / (1 + np.exp(-tracks.log_odds)),
        np.concatenate([given.rival_posterior, np.zeros(new)]),
        {
            name: _reasons(given.reasons[name], tracks.index[:, view], len(own.ends_px))
            for view, (name, own) in enumerate(zip(after.names, after.segments, strict=True))
        },
        given.counts | added,
        covariance,
        np.where(views > 2, tracks.misfit, 0.0),
        flag_viewpoint_dependent(seen, tracks.index, tracks.ends_mm, tracks.misfit, tuning.tracks),
        given.noise_scale,
        given.notes,
        given.noise_tail,
    ).with_marks(guided=guided)


def _reasons(words: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """The words on each segment, those that are on a track now "matched", if none
    said so before."""
    longer = np.concatenate([words, np.full(count - len(words), MATCHED)])
    on = np.unique(index[index >= 0])
    longer[on[~np.char.startswith(longer[on], MATCHED)]] = MATCHED
    return longer
