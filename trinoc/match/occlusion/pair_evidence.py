"""What is judged of pairs: their values, and evidence that both ways of choosing them count."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates import Candidates
from trinoc.match.evidence import MixtureParameters, log_place, log_sides
from trinoc.match.occlusion.possible_pairs import PossiblePairs
from trinoc.match.occlusion.solids import NO_BODIES, Bodies
from trinoc.match.selection import JunctionParameters, Tracks, affordable, claimed
from trinoc.match.tuning import EndTuning, MatchTuning
from trinoc.numerics import broadcast_groups, take_groups, take_rows


class Pairs(NamedTuple):
    """Candidate pairs (chi-square is zero), their log odds without and with rivals, those taken.

    missed : what it costs each, in log odds, that no third view shows it where one should.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    missed: Float[np.ndarray, "m"]

    def take(self, rows: np.ndarray) -> "Pairs":
        """Those at the given indices, in that order, or where the mask is true."""
        return take_rows(self, rows)


class PairStart(NamedTuple):
    """What is known of each frame before its pairs are judged."""

    mixture: MixtureParameters
    junctions: JunctionParameters


class PairsBeside(NamedTuple):
    """Pairs of some frames, the lines of these that are matched, the frames of both, the ends of
    all segments in their pictures, and what lines tell of the frames' bodies."""

    found: PossiblePairs
    matched: Tracks
    frame: Int[np.ndarray, "m"] | None
    matched_frame: Int[np.ndarray, "t"] | None
    ends_px: Float[np.ndarray, "v n 2 2"]
    bodies: Bodies = NO_BODIES

    def take(self, rows: np.ndarray) -> "PairsBeside":
        """With some of the pairs."""
        return self._replace(found=take_rows(self.found, rows), frame=take_groups(self.frame, rows))


def likely_rows(
    beside: PairsBeside, odds: Float[np.ndarray, "m"], tuning: MatchTuning
) -> Int[np.ndarray, "k"]:
    """Rows of pairs that are likely at all, and need no part of a segment that is matched."""
    rows = np.flatnonzero(odds > tuning.selection.prune_log_odds)
    candidates, lines = beside.found.candidates.take(rows), beside.matched.candidates
    parts = candidates.index, candidates.interval, lines.index, lines.interval
    rows = rows[~claimed(*parts, tuning.selection)]
    index = beside.found.candidates.index[rows]
    return rows[affordable(odds[rows], index, tuning.selection)]


def evidence_beside_lines(
    found: PossiblePairs,
    mixture: MixtureParameters,
    frame: Int[np.ndarray, "m"] | None,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Log odds of pairs among matched lines, but for how seldom pairs are, and for junctions."""
    rules, candidates = tuning.occlusion, found.candidates
    ends = log_ends(candidates, broadcast_groups(end_shares(mixture, tuning.ends), frame))
    ends += log_sides(candidates.side_log, mixture, frame)
    in_images = candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset)
    evidence = candidates.log_density + ends + found.expected * float(np.log(rules.missed))
    place = log_place(candidates.ends_mm, mixture.volume, tuning.evidence, frame)
    return evidence + offset + broadcast_groups(mixture.log_count, frame) + place


def log_ends(candidates: Candidates, shares: Float[np.ndarray, "*m c"]) -> Float[np.ndarray, "m"]:
    """Evidence of the ends, by the shares of their components."""
    return np.log((np.exp(candidates.end_log) @ shares[..., None])[..., 0]).sum(axis=1)


def end_shares(mixture: MixtureParameters, tuning: EndTuning) -> Float[np.ndarray, "*f c"]:
    """How the ends of two views agree follows from how those of three do."""
    all_agree, two_agree = len(tuning.agreeing_px), len(tuning.pair_px)
    agreeing = mixture.ends[..., :all_agree].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = mixture.ends[..., all_agree : all_agree + two_agree]
    on = mixture.ends[..., all_agree + two_agree : -1]
    agreeing[..., :two_agree] += (short + on) / 3
    return np.concatenate([agreeing, 1 - agreeing.sum(axis=-1, keepdims=True)], axis=-1)
