"""What minimisers of optimistix' kind have in common that step on a manifold and damp their steps.

They move points, not vectors: each lays its charts anew where it stands, tries a step, takes it
where it gains, and keeps its cost and damping in a `DampedDescent`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, PyTree, Scalar

from trinoc.numerics.arrays import ArrayLike

# The cost is a chi-square: a gain this small moves no parameter by some hundredths of its sigma.
CONVERGED_GAIN = 1e-4

Point = TypeVar("Point")
Aux = TypeVar("Aux")
State = TypeVar("State", bound="DampedDescent")


class DampedDescent(eqx.Module):
    """Cost where a solver stands, how it is damped there, and whether it may stop."""

    cost: Float[ArrayLike, ""]
    damping: Float[ArrayLike, ""]
    done: Bool[ArrayLike, ""]


class AbstractManifoldMinimiser(optx.AbstractMinimiser[Point, Aux, State]):
    """Ends where its state says so; subclasses say how it starts (`init`) and goes on (`step`).

    Fields
    ------
    atol : gain in chi-square at which the fit has converged.
    rtol, norm : not used; a chi-square has a scale of its own.
    """

    rtol: float = 0.0
    atol: float = CONVERGED_GAIN
    norm: Callable[[PyTree], Scalar] = eqx.field(default=optx.max_norm, static=True)

    def terminate(
        self,
        fn: Any,
        y: Point,
        args: Any,
        options: dict[str, Any],
        state: State,
        tags: frozenset[object],
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Converged, or nowhere to go; a cost that is no number ends at once."""
        failed = ~jnp.isfinite(state.cost)
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return jnp.asarray(state.done) | failed, result

    def postprocess(
        self,
        fn: Any,
        y: Point,
        aux: Aux,
        args: Any,
        options: dict[str, Any],
        state: State,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Point, Aux, dict[str, Any]]:
        """The point as it is, with its cost among the statistics."""
        return y, aux, {"cost": state.cost}
