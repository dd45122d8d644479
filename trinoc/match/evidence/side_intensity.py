"""Levels beside a segment as evidence: in diffuse light a surface is as bright in all views.

Of the two surfaces that meet in an edge both, one (where the other is a background that differs
between views) or none look the same in all pictures. How often each happens, and how nearly the
levels agree, is estimated from the images at hand by `em_step`.

The darker side of a line in space is on one side in all pictures: evidence, never a gate.
"""

from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import EvidenceTuning, SideTuning


def polarity_evidence(
    polarity: Float[np.ndarray, "v n"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Log likelihood ratio of the members' darker sides, as of one line over clutter's.

    `polarity` is +1 or -1 along the way from a segment's first end, 0 where not known.
    """
    views = np.arange(polarity.shape[0])
    along = np.where(interval[..., 1] > interval[..., 0], 1.0, -1.0)
    side = np.where(index >= 0, polarity[views, index] * along, 0.0)
    right, left = (side > 0).sum(axis=1), (side < 0).sum(axis=1)
    turned, straight = tuning.turned_share, 1 - tuning.turned_share
    as_one = straight**right * turned**left + straight**left * turned**right
    return np.log(as_one) + (right + left - 1) * np.log(2)


_NONE = len(DEFAULT.sides.agreeing)
# numerical: how the one side agrees and how the other; which is which does not matter.
SIDE_COMPONENTS = list(combinations_with_replacement(range(_NONE + 1), 2))


def side_evidence(
    sides: Float[np.ndarray, "v n 7"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SideTuning = DEFAULT.sides,
) -> Float[np.ndarray, "m s"]:
    """Log density of the members' levels under each of SIDE_COMPONENTS, over that of clutter.

    Zero where the levels of fewer than two members are known, and the contrasts of fewer than two
    others. `sides` is of `side_table`.
    """
    by_levels = _of_levels(sides[..., :5], index, interval, tuning)
    return by_levels + _of_contrasts(sides[..., 5:], index, tuning)


def _of_contrasts(
    contrasts: Float[np.ndarray, "v n 2"], index: Int[np.ndarray, "m v"], tuning: SideTuning
) -> Float[np.ndarray, "m s"]:
    """The same of the step between both levels alone: where one differs, the step may be any."""
    evidence = np.zeros((len(index), len(SIDE_COMPONENTS)))
    if np.isnan(contrasts[..., 0]).all():
        return evidence
    own = contrasts[np.arange(len(contrasts)), index]
    known = (index >= 0) & ~np.isnan(own[..., 0])
    own = np.where(known[..., None], own, 0.0)
    count = np.maximum(known.sum(axis=1), 1)
    mean = own[..., 0].sum(axis=1) / count
    scatter = (np.where(known, own[..., 0] - mean[:, None], 0.0) ** 2).sum(axis=1)
    strange = own[..., 1].sum(axis=1) * (count - 1) / count
    for column, (one, other) in enumerate(SIDE_COMPONENTS):
        if other < _NONE:
            variance = tuning.agreeing[one] ** 2 + tuning.agreeing[other] ** 2
            alike = -0.5 * scatter / variance - (count - 1) / 2 * np.log(2 * np.pi * variance)
            evidence[:, column] = alike - 0.5 * np.log(count) - strange
    return np.where((count > 1)[:, None], evidence, 0.0)


def _of_levels(
    sides: Float[np.ndarray, "v n 5"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SideTuning,
) -> Float[np.ndarray, "m s"]:
    if np.isnan(sides[..., 0]).all():
        return np.zeros((len(index), len(SIDE_COMPONENTS)))
    own = sides[np.arange(len(sides)), index]
    against = interval[..., 1] < interval[..., 0]
    own = np.where(against[..., None], own[..., [1, 0, 3, 2, 4]], own)
    known = ((index >= 0) & ~np.isnan(own[..., 0]))[..., None]
    own = np.where(known, own, 0.0)
    count = np.maximum(known.sum(axis=1), 1)
    mean = own[..., :2].sum(axis=1) / count
    scatter = (np.where(known, own[..., :2] - mean[:, None], 0.0) ** 2).sum(axis=1)
    # Under clutter every member draws its own level; under one line all share a single draw. So
    # the clutter density enters (count - 1) times.
    strange = own[..., 2:].sum(axis=1) * (count - 1) / count
    agreeing = np.array(tuning.agreeing)
    alike = (
        -0.5 * scatter[..., None] / agreeing**2
        - (count - 1)[..., None] * np.log(np.sqrt(2 * np.pi) * agreeing)
        - 0.5 * np.log(count)[..., None]
    )
    right, left = alike[:, 0], alike[:, 1]
    terms = []
    for one, other in SIDE_COMPONENTS:
        if other < _NONE:
            terms.append(
                _log_mean(right[:, one] + left[:, other], right[:, other] + left[:, one])
                - strange[:, 2]
            )
        elif one < _NONE:
            terms.append(_log_mean(right[:, one] - strange[:, 0], left[:, one] - strange[:, 1]))
        else:
            terms.append(np.zeros(len(index)))
    return np.where(count > 1, np.stack(terms, axis=1), 0.0)


def _log_mean(one: Float[np.ndarray, "m"], other: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Logarithm of the mean of two, from their logarithms."""
    return np.logaddexp(one, other) - np.log(2)
