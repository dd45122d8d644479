"""Levenberg and Marquardt's method for everything whose normal equations are a block arrow.

Lenses, cameras and boards share few unknowns (the head), and every shot or line has a few of its
own (a block). The state is a point on a manifold: charts are laid anew at every point, and the
Jacobian is never formed. Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000).
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from trinoc.numerics.block_arrow import BlockArrow, BlockArrowSolver
from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace
from trinoc.numerics.programs import count_numbers, kept_jit

State = TypeVar("State")

# numerical: the cost is a chi-square; so small a gain moves no parameter by a few hundredths of its
# sigma.
CONVERGED_GAIN = 1e-4
# numerical: bounds of the damping.
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e8
# numerical: keeps directions that nothing determines, and those that are held, at rest.
FLOOR_DAMPING = 1e-13
# numerical: a descent ends long before.
MOST_STEPS = 300
# numerical: a step that promises less of the chi-square may rise if the next one makes up for it:
# along a curved valley, such as a lens that the pictures tell less than its prior, all do.
_NEAR = 10.0
# numerical: where blocks step by themselves, the gain of a descent that has converged is granted to
# the head and to every hundred blocks, a few of which creep along the flank of the robust loss.
BLOCKS_THAT_CREEP = 100


class ArrowEquations(NamedTuple):
    """Gauss and Newton's equations: `information` times the step is minus `gradient`.

    `information` is J^T W J, and `gradient` J^T W r, half the gradient of the cost, over the steps
    of the head (h,) and of the blocks (b, w). `cost` is that of the state.
    """

    cost: Float[ArrayLike, ""]
    information: BlockArrow
    gradient: tuple[Float[Array, "h"], Float[Array, "b w"]]


class AbstractArrowProblem(eqx.Module, Generic[State]):
    """A robust least-squares problem over states of any kind that are PyTrees of arrays.

    What is held fixed has no information, no gradient, and a `retract` that ignores its step. From
    so many numbers of a state on, steps run for longer than it takes to optimize their program.
    """

    first_damping: ClassVar[float] = 1e-3
    optimized_from: ClassVar[float] = float("inf")

    @abstractmethod
    def equations(self, state: State) -> ArrowEquations:
        """The equations at a state, weighted by the loss, with the priors, and its cost, the robust
        chi-square of all observations and priors, which decides on a step."""

    @abstractmethod
    def retract(self, state: State, head: Float[Array, "h"], blocks: Float[Array, "b w"]) -> State:
        """The state after a step in the charts laid there; zero leaves it as it is."""


class Costs(NamedTuple):
    """What of a cost depends on the head alone, and what on each block as well."""

    head: Float[ArrayLike, ""]
    blocks: Float[ArrayLike, "b"]

    @property
    def total(self) -> Float[ArrayLike, ""]:
        """The whole cost."""
        return self.head + jnp.sum(self.blocks)


class AbstractSeparableProblem(AbstractArrowProblem[State]):
    """A problem of so many blocks that one which strays would hold back all others.

    Every block has a damping of its own, and stays where it was when that serves it better.
    """

    @abstractmethod
    def costs(self, state: State) -> Costs:
        """The parts of the cost."""

    def cost(self, state: State) -> Float[ArrayLike, ""]:
        """Their sum."""
        return self.costs(state).total


class Solution(eqx.Module, Generic[State]):
    """Where the descent ended, after how many steps, and whether it converged."""

    state: State
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


def solve(
    problem: AbstractArrowProblem[State], state: State, first_damping: ScalarLike | None = None
) -> Solution[State]:
    """The state of least cost near a start.

    first_damping : of the first step, over the diagonal of the equations; that of the problem
        unless given. With `LEAST_DAMPING` it is Gauss and Newton's, for a start so near that it
        gains: directions that are known a million times less well than others move at once.

    Directions that nothing determines keep their start. Differentiating it raises: a state has
    more numbers than freedoms.
    """
    damping = problem.first_damping if first_damping is None else first_damping
    descend = _descend_many if count_numbers(state) >= problem.optimized_from else _descend_few
    return descend(problem, state, array_namespace(damping).asarray(damping, dtype=float))


def _descend(
    problem: AbstractArrowProblem[State], state: State, first_damping: Float[Array, ""]
) -> Solution[State]:
    def cost_and_equations(state: Any, problem: Any) -> tuple[Any, ArrowEquations]:
        equations = _equations(problem, state)
        return equations.cost, equations

    solution = optx.minimise(
        cost_and_equations,
        ArrowDescent(problem=problem, first_damping=first_damping),
        jax.tree.map(jnp.asarray, state),
        problem,
        has_aux=True,
        max_steps=MOST_STEPS,
        throw=False,
    )
    return Solution(
        solution.value,
        jnp.asarray(solution.aux.cost),
        solution.stats["num_steps"] - 1,  # the first is of nothing
        solution.result == optx.RESULTS.successful,
    )


# numerical: a descent of few numbers is not optimized, one of many always.
_descend_few = kept_jit(_descend, optimized_from=1 << 20)
_descend_many = kept_jit(_descend, optimized_from=0)  # numerical: see above


@jax.jit
def _equations(problem: AbstractArrowProblem[State], state: State) -> ArrowEquations:
    """Traced once for the whole descent."""
    return problem.equations(state)


class _Progress(eqx.Module):
    """The best state so far, the equations there and where the descent stands, whether it stands
    above the best, how it is damped, and whether it may stop."""

    best: Any
    at_best: ArrowEquations
    here: ArrowEquations
    risen: Bool[Array, ""]
    damping: Float[Array, ""]
    block_damping: Float[Array, "b"]
    done: Bool[Array, ""]


class _Step(NamedTuple):
    """A step of the head and of the blocks, what it promises, which blocks take part, and a gain
    that is as good as none."""

    head: Float[Array, "h"]
    blocks: Float[Array, "b w"]
    promised: Float[ArrayLike, ""]
    follows: Bool[ArrayLike, "b"]
    negligible: ScalarLike


class ArrowDescent(optx.AbstractMinimiser[Any, ArrowEquations, _Progress]):
    """Levenberg and Marquardt's descent: a damped step from where it stands, taken where it gains.

    The function to minimise returns the cost and, as its auxiliary output, the equations there,
    which say the next step. Of it there is one copy in the program, after a step: the equations at
    the start are found by a first step of nothing.

    Source of steps that may rise: Chamberlain et al., "The watchdog technique for forcing
    convergence in algorithms for constrained optimization" (1982).
    """

    problem: AbstractArrowProblem
    first_damping: Float[Array, ""]
    atol: float = CONVERGED_GAIN
    # optimistix wants these: a chi-square has a scale of its own, and `atol` alone ends the steps.
    rtol: ClassVar[float] = 0.0
    norm: ClassVar[Callable[[PyTree], Float[Array, ""]]] = staticmethod(optx.max_norm)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _Progress:
        """Nothing known yet: no information, and any cost gains."""
        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct)
        nothing = zeros._replace(cost=jnp.full_like(zeros.cost, jnp.inf))
        # A step that gains divides it by ten.
        damping, no = 10 * self.first_damping, jnp.asarray(False)
        blocks = jnp.full(zeros.gradient[1].shape[0], damping)
        return _Progress(y, nothing, nothing, no, damping, blocks, no)

    def step(self, fn, y, args, options, state, tags) -> tuple[Any, _Progress, ArrowEquations]:
        """Try one step; one that rises near the minimum may be followed by another."""
        least = state.at_best.cost
        step = self._find_step(y, state)
        tried = self.problem.retract(y, step.head, step.blocks)
        _, there = fn(tried, args)
        better = there.cost <= least
        rises = ~better & ~state.risen & (step.promised < _NEAR) & jnp.isfinite(there.cost)
        enough = step.promised < self.atol
        still = enough & (least - there.cost < step.negligible)
        stuck = (state.damping * 10 > MOST_DAMPING) | (step.promised < 1e-3 * self.atol)
        factor = jnp.where(better, 0.1, jnp.where(rises, 1.0, 10.0))
        of_blocks = jnp.where(step.follows, factor, 10.0)
        best, at_best = _where(better, (tried, there), (state.best, state.at_best))
        y, here = _where(rises & ~stuck, (tried, there), (best, at_best))
        progress = _Progress(
            best,
            at_best,
            here,
            jnp.asarray(rises),
            jnp.maximum(state.damping * factor, LEAST_DAMPING),
            jnp.clip(state.block_damping * of_blocks, LEAST_DAMPING, MOST_DAMPING),
            jnp.where(better, still, stuck),
        )
        return y, progress, at_best

    def _find_step(self, y: Any, state: _Progress) -> _Step:
        problem, gradient = self.problem, state.here.gradient
        solver = BlockArrowSolver(state.damping + FLOOR_DAMPING, state.block_damping)
        factored = solver.init(state.here.information, {})
        solution = lx.linear_solve(
            state.here.information, gradient, solver, state=factored, throw=False
        )
        head, blocks = jax.tree.map(jnp.negative, solution.value)
        if not isinstance(problem, AbstractSeparableProblem):
            promised = -(gradient[0] @ head) - jnp.sum(gradient[1] * blocks)
            return _Step(head, blocks, promised, jnp.ones(len(blocks), bool), self.atol)
        both = jnp.stack([blocks, jnp.zeros_like(blocks)])
        moved, stayed = jax.vmap(lambda own: problem.costs(problem.retract(y, head, own)).blocks)(
            both
        )
        follows = moved <= stayed
        promised = -factored.elimination.reduced_side(gradient) @ head
        negligible = self.atol * (1 + len(blocks) / BLOCKS_THAT_CREEP)
        return _Step(head, jnp.where(follows[:, None], blocks, 0.0), promised, follows, negligible)

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Converged, or nowhere to go; it has failed where no cost was a number."""
        failed = state.done & ~jnp.isfinite(state.at_best.cost)
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return state.done, result

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[Any, ArrowEquations, dict[str, Any]]:
        """The best state, and the equations there."""
        return state.best, state.at_best, {}


def _where(condition: Bool[ArrayLike, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), yes, no)


def gauss_newton_gain(equations: ArrowEquations) -> Float[Array, ""]:
    """What an undamped step takes off the cost, to first order in the residuals."""
    solver = BlockArrowSolver(FLOOR_DAMPING)
    solved = lx.linear_solve(equations.information, equations.gradient, solver, throw=False).value
    (head, blocks), (of_head, of_blocks) = solved, equations.gradient
    return of_head @ head + jnp.sum(of_blocks * blocks)
