"""Where segments end along their common line, as evidence.

Detectors end partners at one place, more or less, or break one of them: at each end the views
all agree, or two agree and the third stops short or runs on, or nothing agrees. The evidence
is that mixture over ends thrown uniformly on the longest of the segments. How often each
happens is the detector's own habit, learned from the pictures at hand by `evidence.learn`.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.arrays import ArrayLike

AGREEING_PX = (0.7, 2.0, 5.0, 12.0)
PAIR_PX = (0.7, 2.0, 5.0)
# All agree, by scale; two agree and the third stops short, by scale; or runs on; none agree.
COMPONENTS = len(AGREEING_PX) + 2 * len(PAIR_PX) + 1
USUAL_SHARES = np.array([0.35, 0.2, 0.08, 0.05, 0.08, 0.05, 0.04, 0.04, 0.03, 0.03, 0.05])
_LOWEST = -80.0


def end_evidence(extent_px: Float[ArrayLike, "3 2"]) -> Float[ArrayLike, "2 k"]:
    """Log of each component's density over that of strangers, at both ends of a triple."""
    longest = (extent_px[:, 1] - extent_px[:, 0]).max()
    inward = jnp.stack([extent_px[:, 0], -extent_px[:, 1]])
    return jax.vmap(_components, in_axes=(0, None))(inward, longest)


def _components(
    inward_px: Float[ArrayLike, "3"], longest_px: Float[ArrayLike, ""]
) -> Float[ArrayLike, "k"]:
    log_longest = jnp.log(longest_px)
    scatter = ((inward_px - inward_px.mean()) ** 2).sum()
    agreeing = [
        2 * log_longest - jnp.log(2 * jnp.pi * jnp.sqrt(3.0) * s * s) - scatter / (2 * s * s)
        for s in AGREEING_PX
    ]
    short, on = [], []
    for s in PAIR_PX:
        pairs = []
        for odd in range(3):
            first, second = inward_px[(odd + 1) % 3], inward_px[(odd + 2) % 3]
            log_pair = (
                log_longest
                - jnp.log(2 * s * jnp.sqrt(jnp.pi))
                - (first - second) ** 2 / (4 * s * s)
            )
            pairs.append((log_pair - jnp.log(3.0), inward_px[odd] > (first + second) / 2))
        short.append(_log_sum([jnp.where(inside, log, _LOWEST) for log, inside in pairs]))
        on.append(_log_sum([jnp.where(inside, _LOWEST, log) for log, inside in pairs]))
    return jnp.stack([*agreeing, *short, *on, jnp.zeros_like(log_longest)])


def _log_sum(terms: list[Float[ArrayLike, ""]]) -> Float[ArrayLike, ""]:
    return jax.nn.logsumexp(jnp.stack(terms))
