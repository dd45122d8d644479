"""Evidence of the grey levels beside segments: in diffuse light, a surface is equally bright in all
views.

An edge separates two surfaces. Three cases are possible. Both surfaces look the same in all images.
Only one does, because the other is a background that differs between views. None does. `em_step`
estimates the frequency of each case, and the precision of the agreement, from the images at hand.
The darker side of a line in space is also the same in all images. This polarity changes the log
odds, but excludes no candidate.
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
    """Log likelihood ratio of the segments' polarities, one line against clutter, (m,).

    `polarity` is +1 or -1 if the darker side is on the right or on the left, 0 if unknown. `index`
    and `interval` are as in `Candidates`.
    """
    views = np.arange(polarity.shape[0])
    direction = np.where(interval[..., 1] > interval[..., 0], 1.0, -1.0)
    side = np.where(index >= 0, polarity[views, index] * direction, 0.0)
    right_count, left_count = (side > 0).sum(axis=1), (side < 0).sum(axis=1)
    reversed_share, equal_share = tuning.reversed_share, 1 - tuning.reversed_share
    likelihood = (
        equal_share**right_count * reversed_share**left_count
        + equal_share**left_count * reversed_share**right_count
    )
    return np.log(likelihood) + (right_count + left_count - 1) * np.log(2)


_DISAGREE = len(DEFAULT.sides.agreement_scales)
# numerical: unordered pairs of agreement scales, one for each side.
SIDE_COMPONENTS = list(combinations_with_replacement(range(_DISAGREE + 1), 2))


def side_evidence(
    sides: Float[np.ndarray, "v n 7"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SideTuning = DEFAULT.sides,
) -> Float[np.ndarray, "m s"]:
    """Return the evidence of the grey levels beside the segments of each candidate, (m, s).

    For each of the components SIDE_COMPONENTS, the value is the log of a density ratio: component
    over clutter. Segments with known levels and segments with only a contrast are compared
    separately. A comparison needs at least two segments, otherwise its evidence is 0. `sides` is
    the result of `side_table`.
    """
    by_levels = _level_evidence(sides[..., :5], index, interval, tuning)
    return by_levels + _contrast_evidence(sides[..., 5:], index, tuning)


def _contrast_evidence(
    contrasts: Float[np.ndarray, "v n 2"], index: Int[np.ndarray, "m v"], tuning: SideTuning
) -> Float[np.ndarray, "m s"]:
    """Return the evidence of each candidate from segments with a known contrast only, (m, s).

    These are segments whose grey levels on the two sides are unknown, but not the difference of the
    levels. The evidence is the log density ratio of one line over clutter, for each of the
    components SIDE_COMPONENTS. It is 0 for components in which the levels of a side differ between
    the views.
    """
    evidence = np.zeros((len(index), len(SIDE_COMPONENTS)))
    if np.isnan(contrasts[..., 0]).all():
        return evidence
    member_contrast = contrasts[np.arange(len(contrasts)), index]
    is_available = (index >= 0) & ~np.isnan(member_contrast[..., 0])
    member_contrast = np.where(is_available[..., None], member_contrast, 0.0)
    count = np.maximum(is_available.sum(axis=1), 1)
    mean = member_contrast[..., 0].sum(axis=1) / count
    scatter = (np.where(is_available, member_contrast[..., 0] - mean[:, None], 0.0) ** 2).sum(
        axis=1
    )
    log_clutter = member_contrast[..., 1].sum(axis=1) * (count - 1) / count
    for column, (first, second) in enumerate(SIDE_COMPONENTS):
        if second < _DISAGREE:
            variance = tuning.agreement_scales[first] ** 2 + tuning.agreement_scales[second] ** 2
            log_agreement = -0.5 * scatter / variance - (count - 1) / 2 * np.log(
                2 * np.pi * variance
            )
            evidence[:, column] = log_agreement - 0.5 * np.log(count) - log_clutter
    return np.where((count > 1)[:, None], evidence, 0.0)


def _level_evidence(
    sides: Float[np.ndarray, "v n 5"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SideTuning,
) -> Float[np.ndarray, "m s"]:
    if np.isnan(sides[..., 0]).all():
        return np.zeros((len(index), len(SIDE_COMPONENTS)))
    member_level = sides[np.arange(len(sides)), index]
    is_reversed = interval[..., 1] < interval[..., 0]
    member_level = np.where(
        is_reversed[..., None], member_level[..., [1, 0, 3, 2, 4]], member_level
    )
    is_available = ((index >= 0) & ~np.isnan(member_level[..., 0]))[..., None]
    member_level = np.where(is_available, member_level, 0.0)
    count = np.maximum(is_available.sum(axis=1), 1)
    mean = member_level[..., :2].sum(axis=1) / count
    scatter = (np.where(is_available, member_level[..., :2] - mean[:, None], 0.0) ** 2).sum(axis=1)
    # Under clutter every member draws its own level; under one line all share a single draw. So
    # the clutter density enters (count - 1) times.
    log_clutter = member_level[..., 2:].sum(axis=1) * (count - 1) / count
    agreeing = np.array(tuning.agreement_scales)
    log_agreement = (
        -0.5 * scatter[..., None] / agreeing**2
        - (count - 1)[..., None] * np.log(np.sqrt(2 * np.pi) * agreeing)
        - 0.5 * np.log(count)[..., None]
    )
    right_agreement, left_agreement = log_agreement[:, 0], log_agreement[:, 1]
    terms = []
    for first, second in SIDE_COMPONENTS:
        if second < _DISAGREE:
            terms.append(
                _log_mean(
                    right_agreement[:, first] + left_agreement[:, second],
                    right_agreement[:, second] + left_agreement[:, first],
                )
                - log_clutter[:, 2]
            )
        elif first < _DISAGREE:
            terms.append(
                _log_mean(
                    right_agreement[:, first] - log_clutter[:, 0],
                    left_agreement[:, first] - log_clutter[:, 1],
                )
            )
        else:
            terms.append(np.zeros(len(index)))
    return np.where(count > 1, np.stack(terms, axis=1), 0.0)


def _log_mean(
    first: Float[np.ndarray, "m"], second: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m"]:
    """Return log((a + b) / 2), given log a and log b."""
    return np.logaddexp(first, second) - np.log(2)
