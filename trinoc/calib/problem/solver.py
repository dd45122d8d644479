"""Levenberg-Marquardt method for problems whose normal equations are a block arrow.

A few unknowns are shared (in the code `head`): lenses, cameras and boards, or pose and brightness
of an image. Every shot, line or circle has a few unknowns of its own (a block). The state is a
point on a manifold: local coordinates are defined anew at every point. The full Jacobian is never
formed. `ArrowDescent` proposes steps, `WatchdogSearch` accepts or rejects them, `ArrowMinimiser`
runs both. Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000).
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

# numerical: the cost is a chi-square; a gain this small moves parameters by about a hundredth of
# their sigma.
CONVERGED_GAIN = 1e-4
# numerical: bounds of the damping.
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e8
# numerical: keeps undetermined and fixed directions at their start.
FLOOR_DAMPING = 1e-13
# numerical: a descent ends long before.
MOST_STEPS = 300
# numerical: a step with a smaller predicted gain may raise the cost if the next one compensates.
# Along a curved valley all steps do, for instance for a lens that its prior determines.
_NEAR = 10.0
# numerical: with separate dampings of blocks, the final gain is allowed for the head and for every
# hundred blocks, because a few blocks move slowly along the flank of the robust loss.
BLOCKS_THAT_CREEP = 100


class ArrowEquations(NamedTuple):
    """Gauss-Newton equations J^T W J x = -J^T W r of a least-squares problem, and its cost.

    The unknowns are h shared parameters (`head`) and b blocks of w parameters each. Blocks are
    coupled only through the shared parameters, so that J^T W J is a block arrow.

    Attributes
    ----------
    cost : cost at the state where the equations were computed.
    information : J^T W J.
    gradient : J^T W r, half the gradient of the cost, for shared parameters (h,) and blocks (b, w).
    details : additional results of the evaluation; a descent returns those of the last evaluated
        state.
    """

    cost: Float[ArrayLike, ""]
    information: BlockArrow
    gradient: tuple[Float[ArrayLike, "h"], Float[ArrayLike, "b w"]]
    details: Any = None


class AbstractArrowProblem(eqx.Module, Generic[State]):
    """Robust least-squares problem with h shared parameters and b blocks of w parameters each.

    A state is a PyTree of arrays. Fixed unknowns have zero information and gradient, and `retract`
    ignores their change.

    Attributes
    ----------
    first_damping : damping of the first step, relative to the diagonal of the equations.
    optimized_from : number of values in a state above which the compiler optimises the program.
    """

    first_damping: ClassVar[float] = 1e-3
    optimized_from: ClassVar[float] = float("inf")

    @abstractmethod
    def equations(self, state: State) -> ArrowEquations:
        """Gauss-Newton equations at a state, weighted by the robust loss, with the priors.

        Their cost is the robust chi-square of observations and priors. It decides whether a step is
        accepted.
        """

    @abstractmethod
    def retract(self, state: State, head: Float[Array, "h"], blocks: Float[Array, "b w"]) -> State:
        """State after small changes in the local coordinates at `state`. Changes of 0 have no
        effect.

        head : (h,) change of the parameters that all blocks share.
        blocks : (b, w) change of the parameters of each block.
        """


class Costs(NamedTuple):
    """Cost of a state, in parts.

    A block is a group of parameters that only its own observations involve, such as those of one
    line.

    Attributes
    ----------
    head : part that depends only on the parameters that all blocks share.
    blocks : (b,) part of each block.
    """

    head: Float[ArrayLike, ""]
    blocks: Float[ArrayLike, "b"]

    @property
    def total(self) -> Float[ArrayLike, ""]:
        """Sum of all parts of the cost."""
        return self.head + jnp.sum(self.blocks)


class AbstractSeparableProblem(AbstractArrowProblem[State]):
    """Least-squares problem whose blocks have separate dampings.

    With one common damping, a single diverging block would stop all others. A block does not change
    in a step that would increase its cost.
    """

    @abstractmethod
    def costs(self, state: State) -> Costs:
        """Cost of a state, in parts."""

    def block_costs(self, state: State) -> Float[ArrayLike, "b"]:
        """Part of the cost that belongs to each block of parameters, (b,)."""
        return self.costs(state).blocks

    def cost(self, state: State) -> Float[ArrayLike, ""]:
        """Total cost of a state."""
        return self.costs(state).total


class Solution(eqx.Module, Generic[State]):
    """Result of a minimisation.

    Attributes
    ----------
    state, cost : state of least cost, and its cost.
    steps : number of evaluated steps.
    converged : whether the convergence criterion was met.
    predicted_gain : predicted decrease of the cost by one more step.
    details : additional results of the last evaluated state. They belong to `state` only if
        `has_details`.
    has_details : whether the last evaluated state is `state`.
    """

    state: State
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]
    predicted_gain: Float[Array, ""]
    details: Any
    has_details: Bool[Array, ""]


def solve(
    problem: AbstractArrowProblem[State], state: State, first_damping: ScalarLike | None = None
) -> Solution[State]:
    """Minimise the cost of a problem from an initial state.

    Undetermined directions keep their initial values. The result cannot be differentiated: JAX
    raises an error, because a state has more numbers than degrees of freedom.

    first_damping : damping of the first step, relative to the diagonal of the equations. Default:
        that of the problem. `LEAST_DAMPING` gives the Gauss-Newton method, for a start near the
        minimum; weakly determined directions then change from the first step on.
    """
    damping = problem.first_damping if first_damping is None else first_damping
    run = _solve_many if count_numbers(state) >= problem.optimized_from else _solve_few
    return run(problem, state, array_namespace(damping).asarray(damping, dtype=float))


def descend(
    problem: AbstractArrowProblem[State],
    state: State,
    first_damping: Float[ArrayLike, ""],
    start: ArrowEquations | None = None,
    *,
    atol: ScalarLike = CONVERGED_GAIN,
    most_steps: Int[ArrayLike, ""] | int = MOST_STEPS,
) -> Solution[State]:
    """Minimise the cost of a problem from an initial state, inside a compiled program.

    Parameters
    ----------
    start : equations at the initial state, if they are available. The descent then ends without
        another evaluation as soon as the predicted gain is below `atol`. If their cost is infinite,
        the first step is always accepted.
    atol : decrease of the cost that counts as convergence.
    most_steps : largest number of steps.
    """

    def cost_and_equations(state: Any, problem: Any) -> tuple[Any, ArrowEquations]:
        equations = _equations(problem, state)
        return equations.cost, equations

    # Without equations the first step is zero and succeeds, which divides the damping by ten.
    damping = jnp.asarray(first_damping) * (10 if start is None else 1)
    block_costs = problem.block_costs if isinstance(problem, AbstractSeparableProblem) else None
    solution = optx.minimise(
        cost_and_equations,
        ArrowMinimiser(
            ArrowDescent(problem.retract, block_costs),
            WatchdogSearch(damping, atol, is_separable=block_costs is not None),
            jnp.asarray(most_steps),
            start,
        ),
        jax.tree.map(jnp.asarray, state),
        problem,
        has_aux=True,
        max_steps=MOST_STEPS,
        throw=False,
    )
    progress: _Progress = solution.state
    return Solution(
        solution.value,
        jnp.asarray(progress.at_best.cost),
        progress.steps - int(start is None),  # the first is zero
        solution.result == optx.RESULTS.successful,
        jnp.asarray(progress.step.predicted_gain),
        solution.aux.details,
        progress.is_best,
    )


def _solve(
    problem: AbstractArrowProblem[State], state: State, first_damping: Float[Array, ""]
) -> Solution[State]:
    return descend(problem, state, first_damping)


# numerical: a descent of few numbers is not optimized, one of many always.
_solve_few = kept_jit(_solve, optimized_from=1 << 20)
_solve_many = kept_jit(_solve, optimized_from=0)  # numerical: see above


@jax.jit
def _equations(problem: AbstractArrowProblem[State], state: State) -> ArrowEquations:
    """Equations at a state. `jit` makes JAX trace them only once for a descent."""
    return problem.equations(state)


class Damping(NamedTuple):
    """Damping of a Gauss-Newton step, for shared parameters and blocks as in `ArrowEquations`.

    Attributes
    ----------
    head : damping of the parameters that all blocks share.
    blocks : (b,) damping of each block.
    """

    head: Float[ArrayLike, ""]
    blocks: Float[ArrayLike, "b"]


class ArrowStep(NamedTuple):
    """A proposed change of all unknowns: shared parameters and blocks as in `ArrowEquations`.

    Attributes
    ----------
    head : (h,) change of the parameters that all blocks share.
    blocks : (b, w) change of the parameters of each block.
    predicted_gain : decrease of the cost that the equations predict.
    block_moves : (b,) whether each block changes in this step.
    """

    head: Float[Array, "h"]
    blocks: Float[Array, "b w"]
    predicted_gain: Float[ArrayLike, ""]
    block_moves: Bool[ArrayLike, "b"]


class ArrowDescent(optx.AbstractDescent):
    """Computes damped Gauss-Newton steps for optimistix, from equations that are a block arrow.

    Its state is the present state of the unknowns and the equations there.

    Attributes
    ----------
    retract : function of (state, head, blocks) that returns the state after a change.
    block_costs : function that returns the cost of each block, if blocks have separate dampings;
        else None.
    """

    retract: Callable[..., Any]
    block_costs: Callable[..., Any] | None

    def init(self, y: Any, f_info_struct: Any) -> Any:
        """State before the first step: equations with an infinite cost and zero information."""
        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), f_info_struct)
        return y, zeros._replace(cost=jnp.full_like(zeros.cost, jnp.inf), details=None)

    def query(self, y: Any, f_info: ArrowEquations, state: Any) -> Any:
        """Set the state and the equations from which the next step is computed."""
        return y, f_info

    def step(self, step_size: Any, state: Any) -> tuple[ArrowStep, optx.RESULTS]:
        """Compute a step. `step_size` is the damping. Blocks whose cost the step would increase do
        not change.
        """
        y, equations = state
        solver = BlockArrowSolver(step_size.head + FLOOR_DAMPING, step_size.blocks)
        factored, gradient = solver.init(equations.information, {}), equations.gradient
        solution = lx.linear_solve(
            equations.information, gradient, solver, state=factored, throw=False
        )
        head, blocks = jax.tree.map(jnp.negative, solution.value)
        if self.block_costs is None:
            predicted_gain = -(gradient[0] @ head) - jnp.sum(gradient[1] * blocks)
            step = ArrowStep(head, blocks, predicted_gain, jnp.ones(len(blocks), bool))
            return step, optx.RESULTS.successful
        block_costs, with_and_without = (
            self.block_costs,
            jnp.stack([blocks, jnp.zeros_like(blocks)]),
        )
        cost_with, cost_without = jax.vmap(
            lambda block_steps: block_costs(self.retract(y, head, block_steps))
        )(with_and_without)
        block_moves = cost_with <= cost_without
        predicted_gain = -factored.elimination.reduced_side(gradient) @ head
        step = ArrowStep(
            head, jnp.where(block_moves[:, None], blocks, 0.0), predicted_gain, block_moves
        )
        return step, optx.RESULTS.successful


class _SearchState(NamedTuple):
    """State of `WatchdogSearch`.

    Attributes
    ----------
    damping : damping of the next step.
    step : step that is being evaluated.
    is_above_best : whether the present state has a higher cost than the best state.
    done : whether the descent may end.
    """

    damping: Damping
    step: ArrowStep
    is_above_best: Bool[ArrayLike, ""]
    done: Bool[ArrayLike, ""]


class WatchdogSearch(optx.AbstractSearch):
    """Accepts or rejects steps, and adapts the damping, for optimistix.

    A step that reduces the cost is accepted, and the damping is divided by 10. Near the minimum,
    one step that increases the cost is accepted provisionally. The next step must then reach a cost
    below the best one; otherwise the search returns to the best state. All other steps are
    rejected, and the damping is multiplied by 10.

    Attributes
    ----------
    first_damping : damping of the first step.
    atol : decrease of the cost that counts as convergence.
    is_separable : whether blocks have separate dampings.

    References
    ----------
    Chamberlain et al., "The watchdog technique for forcing convergence in algorithms for
    constrained optimization" (1982).
    """

    first_damping: Float[ArrayLike, ""]
    atol: ScalarLike
    is_separable: bool = eqx.field(static=True)

    def init(self, y: Any, f_info_struct: Any) -> _SearchState:
        """State before the first step: a step of zero, with no predicted decrease of the cost."""
        head, blocks = (jnp.zeros(part.shape, part.dtype) for part in f_info_struct.gradient)
        step = ArrowStep(head, blocks, jnp.zeros(()), jnp.ones(len(blocks), bool))
        damping, no = jnp.asarray(self.first_damping), jnp.asarray(False)
        return _SearchState(Damping(damping, jnp.full(len(blocks), damping)), step, no, no)

    def step(
        self,
        first_step: Bool[Array, ""],
        y: Any,
        y_eval: Any,
        f_info: ArrowEquations,
        f_eval_info: ArrowEquations,
        state: _SearchState,
    ) -> tuple[Any, Bool[Array, ""], optx.RESULTS, _SearchState]:
        """Decide on an evaluated step. Returns (next damping, whether it is accepted, success,
        search state).

        f_info, f_eval_info : equations at the best state, and at the evaluated state.
        """
        damping, step, is_above_best, _ = state
        gain = f_info.cost - f_eval_info.cost
        better = f_eval_info.cost <= f_info.cost
        rises = (
            ~better
            & ~is_above_best
            & (step.predicted_gain < _NEAR)
            & jnp.isfinite(f_eval_info.cost)
        )
        stuck = (damping.head * 10 > MOST_DAMPING) | (step.predicted_gain < 1e-3 * self.atol)
        slow_blocks = len(step.blocks) / BLOCKS_THAT_CREEP if self.is_separable else 0.0
        has_converged = (step.predicted_gain < self.atol) & (gain < self.atol * (1 + slow_blocks))
        factor = jnp.where(better, 0.1, jnp.where(rises, 1.0, 10.0))
        block_factor = jnp.where(step.block_moves, factor, 10.0)
        damping = Damping(
            jnp.maximum(damping.head * factor, LEAST_DAMPING),
            jnp.clip(damping.blocks * block_factor, LEAST_DAMPING, MOST_DAMPING),
        )
        done = jnp.where(better, has_converged, stuck)
        accepted = jnp.asarray(better | (rises & ~stuck))
        return damping, accepted, optx.RESULTS.successful, _SearchState(damping, step, rises, done)


class _Progress(eqx.Module):
    """State of `ArrowMinimiser`.

    Attributes
    ----------
    best, at_best : state of least cost so far, and the equations there.
    point : present state of the unknowns, with the equations there.
    search : state of the search.
    step : next step to evaluate.
    steps : number of evaluated steps.
    is_best : whether the last evaluated state is the best one.
    done : whether the descent has ended.
    """

    best: Any
    at_best: ArrowEquations
    point: Any
    search: _SearchState
    step: ArrowStep
    steps: Int[Array, ""]
    is_best: Bool[Array, ""]
    done: Bool[Array, ""]


class ArrowMinimiser(optx.AbstractMinimiser[Any, ArrowEquations, _Progress]):
    """Levenberg-Marquardt minimiser for optimistix, from `ArrowDescent` and `WatchdogSearch`.

    The minimised function returns the cost and the `ArrowEquations`. The compiled program evaluates
    it at one place only, after each step, and therefore compiles faster.

    Attributes
    ----------
    most_steps : largest number of steps.
    start : equations at the initial state. Without them, a first step of zero computes them. With
        them, a step with a small predicted decrease of the cost is not evaluated.
    """

    descent: ArrowDescent
    search: WatchdogSearch
    most_steps: Int[ArrayLike, ""]
    start: ArrowEquations | None
    # optimistix requires these; only the search's `atol` ends the descent, since a chi-square has
    # its own scale.
    rtol: ClassVar[float] = 0.0
    atol: ClassVar[float] = CONVERGED_GAIN
    norm: ClassVar[Callable[[PyTree], Float[Array, ""]]] = staticmethod(optx.max_norm)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _Progress:
        """State before the first step. The first step is computed if the equations are given."""
        point, search = self.descent.init(y, aux_struct), self.search.init(y, aux_struct)
        step, done = search.step, jnp.asarray(False)
        if self.start is not None:
            point = self.descent.query(y, self.start._replace(details=None), point)
            step, _ = self.descent.step(search.damping, point)
            done = jnp.isfinite(self.start.cost) & (step.predicted_gain < self.search.atol)
        search = search._replace(step=step)
        return _Progress(y, point[1], point, search, step, jnp.asarray(0), done, done)

    def step(self, fn, y, args, options, state, tags) -> tuple[Any, _Progress, ArrowEquations]:
        """Evaluate the proposed step, accept or reject it, and propose the next one."""
        trial_state = self.descent.retract(y, state.step.head, state.step.blocks)
        _, evaluated = fn(trial_state, args)
        evaluated_equations = evaluated._replace(details=None)
        damping, accepted, _, search = self.search.step(
            state.steps == 0,
            state.best,
            trial_state,
            state.at_best,
            evaluated_equations,
            state.search,
        )
        better = jnp.asarray(evaluated_equations.cost <= state.at_best.cost)
        best, at_best = _where(
            better, (trial_state, evaluated_equations), (state.best, state.at_best)
        )
        point = _where(accepted, (trial_state, evaluated_equations), (best, at_best))
        step, _ = self.descent.step(damping, self.descent.query(point[0], point[1], state.point))
        steps = state.steps + 1
        done = search.done | (steps >= self.most_steps)
        if self.start is not None:
            done |= better & (step.predicted_gain < self.search.atol)
        search = search._replace(step=step)
        progress = _Progress(best, at_best, point, search, step, steps, better, jnp.asarray(done))
        return point[0], progress, evaluated

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """True if the descent has ended. The result is an error if no evaluated cost was finite."""
        failed = state.done & ~jnp.isfinite(state.at_best.cost)
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return state.done, result

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[Any, ArrowEquations, dict[str, Any]]:
        """Return the state of least cost, and the equations of the last evaluated state."""
        return state.best, aux, {}


def _where(condition: Bool[ArrayLike, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), yes, no)


def gauss_newton_gain(equations: ArrowEquations) -> Float[Array, ""]:
    """Decrease of the cost that an undamped Gauss-Newton step would give if residuals
    were linear.
    """
    solver = BlockArrowSolver(FLOOR_DAMPING)
    solved = lx.linear_solve(equations.information, equations.gradient, solver, throw=False).value
    (head, blocks), (head_gradient, block_gradient) = solved, equations.gradient
    return head_gradient @ head + jnp.sum(block_gradient * blocks)
