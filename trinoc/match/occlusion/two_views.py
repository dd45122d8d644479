"""What two views alone teach about pairs: how many lines of each length, how ends agree, junctions.

No third view checks a pair, so that its odds are as good as the rates that they are compared with.
These are learned from all candidates by EM: pieces that a detector broke are short, and seldom have
a partner in the other view; in a scene without junctions, ends meet by chance.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates import Candidates
from trinoc.match.evidence import MixtureParameters, volume_of
from trinoc.match.occlusion.places import log_place_among
from trinoc.match.selection import JunctionParameters
from trinoc.match.tuning import MatchTuning
from trinoc.numerics import broadcast_groups, group_sums


class PairRates(NamedTuple):
    """ends : shares of the components of each end, the last is "none agree".
    log_by_length : log of lines of each class of length over what clutter's lengths say.
    mixture : where lines are and how many. junctions : how often ends meet."""

    ends: Float[np.ndarray, "*f c"]
    log_by_length: Float[np.ndarray, "*f k"]
    mixture: MixtureParameters
    junctions: JunctionParameters
    log_place: Float[np.ndarray, "m"] | None


def length_class(candidates: Candidates, tuning: MatchTuning) -> Int[np.ndarray, "m"]:
    """The class of length, in the image, of each candidate."""
    length_px = candidates.px_per_mm * np.linalg.norm(
        candidates.union_ends_mm[:, 1] - candidates.union_ends_mm[:, 0], axis=1
    )
    return np.searchsorted(tuning.occlusion.length_classes_px, length_px)


def learned_rates(
    candidates: Candidates,
    posterior: Float[np.ndarray, "m"],
    rates: PairRates,
    junctions: JunctionParameters,
    typical_px: Float[np.ndarray, "*f"] | float,
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
) -> PairRates:
    """One round of EM, in each frame."""
    rules, frames = tuning.occlusion, np.size(rates.mixture.log_count)
    terms = np.exp(candidates.end_log) * np.expand_dims(broadcast_groups(rates.ends, frame), -2)
    terms /= terms.sum(axis=2, keepdims=True)
    ends = group_sums(posterior[:, None] * terms.sum(axis=1), frame, frames)
    ends += rules.prior_observations * rates.ends
    # Clutter's lengths are spread as t / (length + t)^2.
    borders = np.array([0.0, *rules.length_classes_px])
    below = borders / (borders + np.expand_dims(typical_px, -1))
    usual = np.diff(below, axis=-1, append=1.0)
    in_class = np.eye(len(borders))[length_class(candidates, tuning)]
    count = group_sums(posterior[:, None] * in_class, frame, frames)
    total, prior = group_sums(posterior, frame, frames), rules.prior_observations
    by_length = np.log((count + prior * usual) / (np.expand_dims(total + prior, -1) * usual))
    mixture = rates.mixture._replace(
        volume=volume_of(candidates.ends_mm, posterior, tuning.evidence, frame, frames),
        log_count=np.log(np.maximum(total, 1.0)),
    )
    place = log_place_among(candidates.ends_mm, posterior, mixture.volume, rules, frame)
    ends = ends / ends.sum(axis=-1, keepdims=True)
    return PairRates(ends, by_length, mixture, junctions, place)
