"""Guided detection: every picture is asked again where matched lines must be."""

from collections.abc import Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Shaped

from trinoc.geometry import Rig, Segments
from trinoc.match.guided.answer import matches_of, segments_of
from trinoc.match.guided.further_views import with_further_views
from trinoc.match.guided.new_lines import with_new_lines
from trinoc.match.guided.prolong import prolonged
from trinoc.match.guided.state import State, start_of
from trinoc.match.guided.usual_width import with_usual_width
from trinoc.match.guided.views import PictureInput, picture_inputs
from trinoc.match.observations import as_segments, check_pictures
from trinoc.match.tracks import Matches
from trinoc.match.tuning import DEFAULT, GuidedTuning, MatchTuning
from trinoc.numerics import ArrayLike, in_float64


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
    direction, with a rate of false alarms for these few tests. Asked for are lines in views that
    lack them, what lies beyond the ends of matched segments, and lines that should be there: from
    corner to corner, and from a corner parallel to a line beside it. An edge that two views should
    show and one does not speaks against a match. Rounds until nothing is added.

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
    check_pictures("Guided detection", matches.views, segments, rig, pictures)
    given = {name: as_segments(segments[name]) for name in matches.views}
    inputs = picture_inputs(rig, {name: pictures[name] for name in matches.views})
    before = start_of(matches, given, rig)
    inputs = [
        with_usual_width(picture, shown.ends_px)
        for picture, shown in zip(inputs, before.segments, strict=True)
    ]
    after, added = rounds(before, inputs, tuning.guided)
    tables = segments_of(before, after, given)
    return GuidedMatches(tables, matches_of(after, matches, added, tuning))


def rounds(
    state: State, pictures: list[PictureInput], tuning: GuidedTuning
) -> tuple[State, dict[str, int]]:
    """(the state when nothing more is added, how much was added of each kind)."""
    asked = np.zeros((0, 2, 3))
    total = np.zeros(3, dtype=np.int64)
    for number in range(tuning.rounds):
        state, seen = with_further_views(state, pictures, tuning, weigh=number == 0)
        state, new, asked = with_new_lines(state, pictures, asked, tuning)
        state, longer = prolonged(state, pictures, tuning)
        total += [seen, new, longer]
        if seen + new + longer == 0:
            break
    words = "guided: views added to tracks", "guided: new tracks", "guided: segments lengthened"
    return state, dict(zip(words, total.tolist(), strict=True))
