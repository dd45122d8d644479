"""New lines: those of the hypotheses that two pictures or more show."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from trinoc.geometry import project_by_matrix
from trinoc.match.guided.accept import with_accepted
from trinoc.match.guided.corners import corners_of, ends_of
from trinoc.match.guided.joint import asked
from trinoc.match.guided.partners import hypotheses_of
from trinoc.match.guided.proposals import proposals_of
from trinoc.match.guided.quick_look import quick_look, without
from trinoc.match.guided.state import State
from trinoc.match.guided.views import PictureInput
from trinoc.match.tuning import GuidedTuning
from trinoc.numerics import take_rows


def with_new_lines(
    state: State,
    pictures: list[PictureInput],
    before_mm: Float[np.ndarray, "m 2 3"],
    tuning: GuidedTuning,
) -> tuple[State, int, Float[np.ndarray, "k 2 3"]]:
    """(the state with new tracks, how many, the lines asked for); `before_mm` are those of earlier
    rounds, which are not asked for again."""
    ends = ends_of(state, tuning)
    if len(ends.place_mm) == 0:
        return state, 0, before_mm
    hypotheses = hypotheses_of(state, ends, corners_of(state, ends, tuning), tuning)
    new = _first_time(hypotheses.ends_mm, before_mm, tuning)
    hypotheses = take_rows(hypotheses, new)
    before_mm = np.concatenate([before_mm, hypotheses.ends_mm])
    promising = _promising(state, pictures, hypotheses.ends_mm, tuning)
    if not promising.any():
        return state, 0, before_mm
    hypotheses = take_rows(hypotheses, promising)
    wanted = _looks(pictures, hypotheses.ends_mm) > tuning.asked_sigmas
    found = asked(pictures, hypotheses.ends_mm, hypotheses.covariance_mm2, wanted, tuning)
    sizes = [picture.size_px for picture in pictures]
    proposals = proposals_of(state, found, hypotheses, sizes, len(promising), tuning)
    return *with_accepted(state, proposals, tuning), before_mm


def _first_time(
    lines_mm: Float[np.ndarray, "n 2 3"],
    before_mm: Float[np.ndarray, "m 2 3"],
    tuning: GuidedTuning,
) -> Bool[np.ndarray, "n"]:
    """Whether no such line has been asked for, either way round."""
    if len(before_mm) == 0 or len(lines_mm) == 0:
        return np.ones(len(lines_mm), dtype=bool)
    both = np.concatenate([before_mm, before_mm[:, ::-1]]).reshape(-1, 6)
    apart = KDTree(both).query(lines_mm.reshape(-1, 6))[0]
    return np.asarray(apart) > tuning.asked_again_mm


def _promising(
    state: State,
    pictures: list[PictureInput],
    lines_mm: Float[np.ndarray, "n 2 3"],
    tuning: GuidedTuning,
) -> Bool[np.ndarray, "n"]:
    """Whether two pictures may show each line, apart from what shows matched lines already."""
    rest = []
    for view, picture in enumerate(pictures):
        used = np.unique(state.tracks.index[:, view])
        matched = state.segments[view].ends_px[used[used >= 0]]
        rest.append(without(picture, matched, tuning.matched_width_px))
    return (_looks(rest, lines_mm) > tuning.plausible_sigmas).sum(axis=1) >= 2


def _looks(
    pictures: list[PictureInput], lines_mm: Float[np.ndarray, "n 2 3"]
) -> Float[np.ndarray, "n v"]:
    """A quick look at every line in every picture."""
    images = [project_by_matrix(picture.matrix_px, lines_mm) for picture in pictures]
    looks = [quick_look(*both) for both in zip(pictures, images, strict=True)]
    return np.stack(looks, axis=1)
