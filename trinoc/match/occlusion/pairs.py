"""Step 3: segments that two views show and the others do not, joined to what is matched.

Two segments that fit are weak evidence, since two views check only their ends. The strong
evidence of a pair is that its ends meet those of matched lines. So the pairs of all views are
judged together with the lines matched so far: their posterior log odds are computed as those of
triples are, and iterated to a fixed point.

possible_pairs -> pair_evidence -> pairs_beside_lines, or pairs_alone (two_views) where hardly any
line is matched.
"""

from itertools import combinations

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates import Candidates, in_depth_range
from trinoc.match.evidence import prior_parameters, reach_of_ends
from trinoc.match.observations import ClutterModel, SegmentTable, frames_of, segments_per_view
from trinoc.match.occlusion.likely_pairs import pair_bound
from trinoc.match.occlusion.pair_evidence import (
    Pairs,
    PairsBeside,
    PairStart,
    end_shares,
    evidence_beside_lines,
)
from trinoc.match.occlusion.pairs_alone import pairs_alone
from trinoc.match.occlusion.pairs_beside_lines import pairs_beside_lines
from trinoc.match.occlusion.possible_pairs import PossiblePairs, possible_pairs
from trinoc.match.occlusion.solids import NO_BODIES, Bodies
from trinoc.match.selection import Selection, Tracks, prior_junctions
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.numerics import ArrayLike, concatenate_rows, group_sums, take_rows


def occluded_pairs(
    lines: SegmentTable,
    counts: list[int],
    clutter: ClutterModel,
    matched: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning = DEFAULT,
    bodies: Bodies = NO_BODIES,
) -> Pairs:
    """Pairs of views matched beside the tracks through three or more, in each frame of a stack;
    `bodies` are what these tracks tell of each frame's (see `solids.py`)."""
    free = _free_segments(matched.candidates, counts, tuning.occlusion.max_matched_share)
    frames = 1 if lines.frame is None else len(lines.matrix_px)
    # Where hardly any line is seen in three views, pairs themselves say how they are.
    number = _rows_of(matched.candidates, lines, frames)
    alone = number < tuning.occlusion.min_tracks_to_learn
    learned = _learned_from(selections, tuning)
    several = lines.frame is not None or alone.any()
    bound, ends_px = None, None
    # In small pictures one more program costs more than it saves.
    if learned is not None and not several and max(counts) > tuning.scouting.above:
        shares = end_shares(learned.mixture, tuning.ends)
        bound = pair_bound(lines, learned.mixture, shares, tuning)
        # Where ends meet others, a pair may be right whose own ends do not agree.
        if not np.any(learned.junctions.end_at_junction >= tuning.junctions.min_at_junction):
            typical_px = float(np.asarray(clutter.typical_px))
            reach_px = reach_of_ends(learned.mixture.ends, typical_px, tuning.scouting, tuning.ends)
            ends_px = None if reach_px is None else tuning.occlusion.ends_reach * reach_px

    def kept(found: PossiblePairs) -> PossiblePairs:
        """In range, and, as far as that is known by now, likely at all: it bounds the memory."""
        found = take_rows(found, in_depth_range(found.candidates, lines, depth_range_mm))
        if learned is None or several:
            return found
        evidence = evidence_beside_lines(found, learned.mixture, None, tuning)
        return take_rows(found, evidence > tuning.selection.prune_log_odds)

    found = concatenate_rows(
        [
            kept(part)
            for views in combinations(range(len(counts)), 2)
            for part in possible_pairs(
                lines, np.array(views), free, clutter, tuning, bound, ends_px
            )
        ]
    )
    frame = frames_of(lines, found.candidates.index)
    typical = segments_per_view(lines, counts)
    start = _start(found, selections, typical, frame, tuning)
    bodies = Bodies(*(np.broadcast_to(each, np.shape(typical)) for each in bodies))
    results = []
    for select, those in ((pairs_alone, alone), (pairs_beside_lines, ~alone)):
        if those.any():
            own = _of_frames(lines, found, matched, those)._replace(bodies=bodies)
            results.append(select(own, start, np.asarray(clutter.typical_px), tuning))
    return concatenate_rows(results)


def _learned_from(selections: list[Selection], tuning: MatchTuning) -> PairStart | None:
    """What three views taught a single frame, if enough."""
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None or most.taken.sum() < tuning.occlusion.min_tracks_to_learn:
        return None
    return PairStart(most.mixture, most.junctions)


def _rows_of(candidates: Candidates, lines: SegmentTable, frames: int) -> Int[np.ndarray, "f"]:
    label = frames_of(lines, candidates.index)
    label = np.zeros(len(candidates.index), np.int64) if label is None else label
    return np.bincount(label, minlength=frames)


def _start(
    found: PossiblePairs,
    selections: list[Selection],
    typical: Float[np.ndarray, "*f"] | float,
    frame: Int[np.ndarray, "m"] | None,
    tuning: MatchTuning,
) -> PairStart:
    """What three views taught, or what is usual where they show few lines."""
    ends_mm = found.candidates.ends_mm
    usual = PairStart(
        prior_parameters(ends_mm, typical, tuning, frame),
        prior_junctions(tuning.junctions, np.shape(typical)),
    )
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None:
        return usual
    number = group_sums(most.taken.astype(np.float64), most.frame, np.size(typical))
    enough = number >= tuning.occlusion.min_tracks_to_learn

    def chosen(learned: ArrayLike | float, usual: ArrayLike | float) -> np.ndarray:
        axes = tuple(range(np.ndim(enough), np.ndim(usual)))
        return np.where(np.expand_dims(enough, axes), learned, usual)

    return jax.tree.map(chosen, PairStart(most.mixture, most.junctions), usual)


def _of_frames(
    lines: SegmentTable,
    found: PossiblePairs,
    matched: Tracks,
    those: Bool[np.ndarray, "f"],
) -> PairsBeside:
    """The pairs of those frames alone."""
    frame = frames_of(lines, found.candidates.index)
    matched_frame = frames_of(lines, matched.candidates.index)
    if frame is not None and matched_frame is not None:
        rows, tracks = np.flatnonzero(those[frame]), np.flatnonzero(those[matched_frame])
        found, frame = take_rows(found, rows), frame[rows]
        matched, matched_frame = matched.take(tracks), matched_frame[tracks]
    return PairsBeside(found, matched, frame, matched_frame, np.asarray(lines.ends_px))


def _free_segments(
    matched: Candidates, counts: list[int], most: float
) -> list[Int[np.ndarray, "_"]]:
    """Per view, the segments of which less than a share of `most` is matched."""
    free = []
    for view, count in enumerate(counts):
        on = matched.index[:, view] >= 0
        length = np.abs(np.diff(matched.interval[on, view], axis=1)[:, 0])
        used = np.bincount(matched.index[on, view], length, minlength=count)
        free.append(np.flatnonzero(used < most))
    return free
