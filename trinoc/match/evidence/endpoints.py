"""Where segments end along their common line, as evidence.

A detector ends the images of one line at nearly the same place, or breaks one of them. At each
end all views agree, or two agree and the third stops short or runs on, or none agree. The
evidence is this mixture against ends that are uniform on the longest segment. The weights of the
mixture depend on the detector. `em_step` estimates them from the images at hand.
"""

import numpy as np
from jaxtyping import Float

from trinoc.match.tuning.candidates import ScoutTuning
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import EndTuning
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import Scalar, largest, total

# All agree, by scale; two agree and the third stops short, by scale; or runs on; none agree.
END_COMPONENTS = len(DEFAULT.ends.prior_shares)
# numerical: a guard of the logarithm.
LEAST_DENSITY = 1e-30


def end_evidence(
    extent_px: tuple[tuple[Scalar, Scalar], ...], tuning: EndTuning = DEFAULT.ends
) -> Float[ArrayLike, "2 c *h"]:
    """Log of each component's density over that of clutter, at both ends of a triple."""
    xp = array_namespace(extent_px)
    # Both ends at once, each inward.
    inward = [xp.stack([low, -high]) for low, high in extent_px]
    longest = largest(high - low for low, high in extent_px)
    components = _components((inward[0], inward[1], inward[2]), longest[None], tuning)
    return xp.swapaxes(components, 0, 1)


def reach_of_ends(
    shares: Float[np.ndarray, "c"],
    typical_px: float,
    rules: ScoutTuning,
    tuning: EndTuning = DEFAULT.ends,
) -> float | None:
    """How far from its place, px, an end lies at most that agrees, by the learned shares of the
    components; None where that is too much of the usual length of segments to tell."""
    scales = np.array([*tuning.agreeing_px, *tuning.pair_px, *tuning.pair_px])
    every = np.sort(tuning.agreeing_px)
    wider = np.array([shares[:-1][scales > scale].sum() for scale in every])
    reach = rules.ends_sigmas * float(every[np.argmax(wider <= rules.ends_wider)])
    return reach if reach < rules.ends_below * typical_px else None


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
    agree = scales(tuning.agreeing_px)
    uniform = np.log(2 * np.pi * np.sqrt(3.0) * agree**2).astype(first.dtype)
    agreeing = 2 * log_longest - uniform - scatter[None] / (2 * agree**2)
    # The difference of two, and whether the odd one stops short of their mean: each of the three is
    # the odd one with the same probability.
    apart = xp.stack([second - first, third - second, first - third])[:, None]
    sums = [(third, first + second), (first, second + third), (second, third + first)]
    short = xp.stack([2 * odd > both for odd, both in sums])[:, None]
    two = scales(tuning.pair_px)
    density = xp.exp(-(apart**2) / (4 * two**2)[None])
    shared = [total(xp.where(odd, density, 0.0)) for odd in (short, ~short)]
    uniform = np.log(6 * np.sqrt(np.pi) * two).astype(first.dtype)
    two_agree = [log_longest - uniform + xp.log(each + LEAST_DENSITY) for each in shared]
    return xp.concatenate([agreeing, *two_agree, xp.zeros_like(first)[None]])
