"""Which pairs may be likely, judged where they were made: most never leave the kernel."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.evidence import MixtureParameters
from trinoc.match.observations import SegmentTable
from trinoc.match.tuning import EvidenceTuning, MatchTuning
from trinoc.numerics import ArrayLike, kept_jit


class PairBound(NamedTuple):
    """What the log odds of a pair among matched lines are made of, but for its polarity.

    prior : what all pairs share. least : below this, pairs are let go.
    """

    log_ends: Float[np.ndarray, "c"]
    centre_mm: Float[np.ndarray, "3"]
    precision: Float[np.ndarray, "3 3"]
    log_missed: float
    prior: float
    least: float


def pair_bound(
    lines: SegmentTable,
    mixture: MixtureParameters,
    end_shares: Float[np.ndarray, "c"],
    tuning: MatchTuning,
) -> PairBound | None:
    """The bound of one frame's pairs; None where side levels, of pictures, say more."""
    if np.isfinite(np.asarray(lines.sides)).any():
        return None
    volume, rules = mixture.volume, tuning.occlusion
    prior = mixture.log_count - volume.log_size - np.log(2 * np.pi) + rules.log_odds_offset
    # As if darker sides agreed.
    prior += np.log(2) * bool(np.asarray(lines.polarity).any())
    return PairBound(
        np.log(end_shares),
        volume.centre_mm,
        volume.precision,
        float(np.log(rules.missed)),
        float(prior),
        tuning.selection.prune_log_odds,
    )


@partial(kept_jit, static_argnames=("tuning",))
def may_be_likely(
    bound: PairBound,
    possible: Bool[ArrayLike, "h"],
    columns: Float[ArrayLike, "k h"],
    tuning: EvidenceTuning,
) -> Bool[ArrayLike, "h"]:
    """Which of the possible pairs are as likely as they have to be; `columns` are those that
    `possible_pairs` makes: intervals, ends, log density, that of the ends, and others."""
    components = len(bound.log_ends)
    ends_mm, log_density, end_log = columns[4:10], columns[10], columns[11 : 11 + 2 * components]
    total = log_density + columns[-2] * bound.log_missed + bound.prior
    square = jnp.zeros_like(total)
    for e in range(2):
        terms = [
            log_share + term
            for log_share, term in zip(
                bound.log_ends, end_log[e * components : (e + 1) * components], strict=True
            )
        ]
        total += jax.nn.logsumexp(jnp.stack(terms), axis=0)
        apart = ends_mm[3 * e : 3 * e + 3] - bound.centre_mm[:, None]
        square = jnp.maximum(square, ((bound.precision @ apart) * apart).sum(axis=0))
    outside = jnp.clip(square - tuning.box_corner_sigmas**2, 0.0, tuning.box_cost)
    return possible & (total - 0.5 * outside > bound.least)
