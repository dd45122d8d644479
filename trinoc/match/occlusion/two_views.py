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
from trinoc.match.selection import JunctionParameters
from trinoc.match.tuning import MatchTuning


class PairRates(NamedTuple):
    """ends : shares of the components of each end, the last is "none agree".
    log_by_length : log of lines of each class of length over what clutter's lengths say.
    mixture : where lines are and how many. junctions : how often ends meet."""

    ends: Float[np.ndarray, "c"]
    log_by_length: Float[np.ndarray, "k"]
    mixture: MixtureParameters
    junctions: JunctionParameters


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
    typical_px: float,
    tuning: MatchTuning,
) -> PairRates:
    """One round of EM."""
    rules = tuning.occlusion
    terms = np.exp(candidates.end_log) * rates.ends
    terms /= terms.sum(axis=2, keepdims=True)
    ends = np.einsum("m,mec->c", posterior, terms) + rules.prior_observations * rates.ends
    # Clutter's lengths are spread as t / (length + t)^2.
    borders = np.array([0.0, *rules.length_classes_px, np.inf])
    below = np.append(borders[:-1] / (borders[:-1] + typical_px), 1.0)
    usual = np.diff(below)
    count = np.bincount(length_class(candidates, tuning), posterior, len(usual))
    total, prior = posterior.sum(), rules.prior_observations
    by_length = np.log((count + prior * usual) / ((total + prior) * usual))
    mixture = rates.mixture._replace(
        volume=volume_of(candidates.ends_mm, posterior, tuning.evidence),
        log_count=float(np.log(max(total, 1.0))),
    )
    return PairRates(ends / ends.sum(), by_length, mixture, junctions)
