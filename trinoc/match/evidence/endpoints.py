"""Where segments end along their common line, as evidence.

A detector ends the images of one line at nearly the same place, or breaks one of them. At each
end all views agree, or two agree and the third stops short or runs on, or none agree. The
evidence is this mixture against ends that are uniform on the longest segment. The weights of the
mixture depend on the detector. `em_step` estimates them from the images at hand.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.match.tuning import DEFAULT, EndTuning, ScoutTuning
from trinoc.numerics import Scalar, largest_of, total

# All agree, by scale; two agree and the third stops short, by scale; or runs on; none agree.
END_COMPONENTS = len(DEFAULT.ends.prior_shares)
LEAST_DENSITY = 1e-30


def end_evidence(
    extent_px: tuple[tuple[Scalar, Scalar], ...], tuning: EndTuning = DEFAULT.ends
) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Log of each component's density over that of clutter, at both ends of a triple."""
    # Both ends at once, each inward.
    inward = [jnp.stack([low, -high]) for low, high in extent_px]
    longest = largest_of(high - low for low, high in extent_px)
    components = _components((inward[0], inward[1], inward[2]), longest[None], tuning)
    return tuple(c[0] for c in components), tuple(c[1] for c in components)


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
) -> tuple[Scalar, ...]:
    log_longest = jnp.log(longest_px)
    first, second, third = inward_px
    mean = (first + second + third) / 3
    scatter = (first - mean) ** 2 + (second - mean) ** 2 + (third - mean) ** 2
    agreeing = tuple(
        2 * log_longest - float(np.log(2 * np.pi * np.sqrt(3.0) * s * s)) - scatter / (2 * s * s)
        for s in tuning.agreeing_px
    )
    # The difference of two, and whether the odd one stops short of their mean: each of the three is
    # the odd one with the same probability.
    apart = jnp.stack([second - first, third - second, first - third])[None]
    sums = [(third, first + second), (first, second + third), (second, third + first)]
    short = jnp.stack([2 * odd > both for odd, both in sums])
    scales = np.array(tuning.pair_px).reshape(-1, *(1,) * (apart.ndim - 1))
    twice_variance = (4 * scales**2).astype(apart.dtype)
    density = jnp.exp(-(apart**2) / twice_variance)
    shared = [total(jnp.where(o[None], density, 0.0).swapaxes(0, 1)) for o in (short, ~short)]
    log_shared = jnp.log(jnp.stack(shared) + LEAST_DENSITY)
    uniform = np.log(6 * np.sqrt(np.pi) * scales[:, 0]).astype(apart.dtype)[None]
    two_agree = log_longest[None, None] - uniform + log_shared
    return (*agreeing, *two_agree[0], *two_agree[1], jnp.zeros_like(first))
