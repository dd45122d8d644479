"""Evidence of the segments' ends along their common line.

A detector usually ends the images of one line at corresponding positions, or breaks one of them. At
each end, there are three cases. All views agree. Two views agree, and the third segment is shorter
or longer. No views agree. The evidence compares the mixture of these cases with ends that are
uniform on the longest segment. The weights of the mixture depend on the detector. `em_step`
estimates them from the images at hand.
"""

import numpy as np
from jaxtyping import Float

from trinoc.match.tuning.candidates import ScoutTuning
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import EndTuning
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import Scalar, largest, total

# Components: all agree (by scale), the third stops short (by scale), the third runs on (by scale),
# none agree.
END_COMPONENTS = len(DEFAULT.ends.prior_shares)
# numerical: avoids the logarithm of 0.
SMALLEST_DENSITY = 1e-30


def end_evidence(
    extent_px: tuple[tuple[Scalar, Scalar], ...], tuning: EndTuning = DEFAULT.ends
) -> Float[ArrayLike, "2 c *h"]:
    """Return the evidence of how well the segment ends of a triple correspond, (2, c, h).

    The c mixture components are the cases that all three segments end together, that two do, or
    that none do, with several scales of the distance. The value is the log of a density ratio:
    component over clutter, for both ends of h triples. `extent_px` are the positions (low, high) of
    each segment along the common line.
    """
    xp = array_namespace(extent_px)
    # Positions of both ends, each counted toward the middle of the line.
    inward = [xp.stack([low, -high]) for low, high in extent_px]
    longest = largest(high - low for low, high in extent_px)
    components = _components((inward[0], inward[1], inward[2]), longest[None], tuning)
    return xp.swapaxes(components, 0, 1)


def end_search_radius_px(
    shares: Float[np.ndarray, "c"],
    typical_px: float,
    scouting: ScoutTuning,
    tuning: EndTuning = DEFAULT.ends,
) -> float | None:
    """Return the largest distance, px, between two segment ends that are tested as corresponding
    ends.

    The distance follows from the estimated weights `shares` of the components of `end_evidence`.
    The result is None if this distance is large relative to the typical segment length.
    """
    scales = np.array([*tuning.agreement_px, *tuning.pair_px, *tuning.pair_px])
    sorted_scales = np.sort(tuning.agreement_px)
    wider_share = np.array([shares[:-1][scales > scale].sum() for scale in sorted_scales])
    radius_px = scouting.ends_sigmas * float(
        sorted_scales[np.argmax(wider_share <= scouting.wide_ends_share)]
    )
    return radius_px if radius_px < scouting.max_ends_share * typical_px else None


def _components(
    inward_px: tuple[Scalar, Scalar, Scalar], longest_px: Scalar, tuning: EndTuning
) -> Float[ArrayLike, "c 2 *h"]:
    first, second, third = inward_px
    xp = array_namespace(inward_px)
    log_longest = xp.log(longest_px)[None]

    def scales(scales_px: tuple[float, ...]) -> np.ndarray:
        return np.array(scales_px, first.dtype).reshape(-1, *(1,) * first.ndim)

    mean = (first + second + third) / 3
    scatter = (first - mean) ** 2 + (second - mean) ** 2 + (third - mean) ** 2
    scale = scales(tuning.agreement_px)
    log_normaliser = np.log(2 * np.pi * np.sqrt(3.0) * scale**2).astype(first.dtype)
    agreeing = 2 * log_longest - log_normaliser - scatter[None] / (2 * scale**2)
    # Difference of two ends, and whether the third ("odd") end stops short of their mean. Each of
    # the three ends is the odd one with the same probability.
    difference = xp.stack([second - first, third - second, first - third])[:, None]
    sums = [(third, first + second), (first, second + third), (second, third + first)]
    stops_short = xp.stack([2 * odd_end > sum_of_pair for odd_end, sum_of_pair in sums])[:, None]
    pair_scale = scales(tuning.pair_px)
    density = xp.exp(-(difference**2) / (4 * pair_scale**2)[None])
    pair_density = [total(xp.where(is_odd, density, 0.0)) for is_odd in (stops_short, ~stops_short)]
    log_normaliser = np.log(6 * np.sqrt(np.pi) * pair_scale).astype(first.dtype)
    two_agree = [
        log_longest - log_normaliser + xp.log(density + SMALLEST_DENSITY)
        for density in pair_density
    ]
    return xp.concatenate([agreeing, *two_agree, xp.zeros_like(first)[None]])
