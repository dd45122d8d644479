"""Levenberg-Marquardt method for problems whose normal equations are a block arrow.

Few unknowns are shared (the head: lenses, cameras and boards, or the pose and look of an image).
Every shot, line or circle has a few of its own (a block). The state is a point on a manifold: local
coordinates are defined anew at every point, and the Jacobian is never formed. `ArrowDescent`
proposes steps, `WatchdogSearch` accepts or rejects them, `ArrowMinimiser` runs both. Source: Triggs
et al., "Bundle adjustment: a modern synthesis" (2000).
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
    """Gauss-Newton equations at a state: `information` times the step is minus `gradient`.

    Attributes
    ----------
    cost : cost of the state.
    information, gradient : J^T W J, and J^T W r (half the gradient of the cost), over the steps of
        the head (h,) and of the blocks (b, w).
    details : other results of the evaluation; a descent returns those of the last evaluated state.
    """

    cost: Float[ArrayLike, ""]
    information: BlockArrow
    gradient: tuple[Float[ArrayLike, "h"], Float[ArrayLike, "b w"]]
    details: Any = None


class AbstractArrowProblem(eqx.Module, Generic[State]):
    """A robust least-squares problem over states that are PyTrees of arrays.

    Fixed unknowns have no information and no gradient, and `retract` ignores their step.

    `optimized_from` : size of a state above which optimizing the program pays off.
    """

    first_damping: ClassVar[float] = 1e-3
    optimized_from: ClassVar[float] = float("inf")

    @abstractmethod
    def equations(self, state: State) -> ArrowEquations:
        """Equations at a state, weighted by the loss, with the priors.

        Their cost, the robust chi-square of observations and priors, decides on a step.
        """

    @abstractmethod
    def retract(self, state: State, head: Float[Array, "h"], blocks: Float[Array, "b w"]) -> State:
        """State after a step in the local coordinates at `state`; a step of zero leaves it
        unchanged.
        """


class Costs(NamedTuple):
    """Parts of the cost: that of the head alone, and that of each block."""

    head: Float[ArrayLike, ""]
    blocks: Float[ArrayLike, "b"]

    @property
    def total(self) -> Float[ArrayLike, ""]:
        """Sum of all parts."""
        return self.head + jnp.sum(self.blocks)


class AbstractSeparableProblem(AbstractArrowProblem[State]):
    """A problem of many blocks with separate dampings.

    A single diverging block would otherwise stop all others. A block does not move if its step
    raises its cost.
    """

    @abstractmethod
    def costs(self, state: State) -> Costs:
        """Parts of the cost."""

    def block_costs(self, state: State) -> Float[ArrayLike, "b"]:
        """Costs of the blocks."""
        return self.costs(state).blocks

    def cost(self, state: State) -> Float[ArrayLike, ""]:
        """Total cost."""
        return self.costs(state).total


class Solution(eqx.Module, Generic[State]):
    """End of a descent.

    Attributes
    ----------
    state, cost : best state and its cost.
    steps : number of tried steps.
    converged : whether the descent ended by its own criterion.
    promised : predicted gain of the next step.
    details : those of the equations at `state`, if `has_details`.
    has_details : whether the last evaluated state is the best one.
    """

    state: State
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]
    promised: Float[Array, ""]
    details: Any
    has_details: Bool[Array, ""]


def solve(
    problem: AbstractArrowProblem[State], state: State, first_damping: ScalarLike | None = None
) -> Solution[State]:
    """Return the state of least cost near a start.

    first_damping : of the first step, relative to the diagonal of the equations; by default that of
        the problem. `LEAST_DAMPING` gives the Gauss-Newton method, for starts near the minimum.
        Then weakly determined directions move at once.

    Undetermined directions keep their start. Differentiation raises an error: a state has more
    numbers than degrees of freedom.
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
    """Return the best state after steps from a start, as part of a compiled program.

    Parameters
    ----------
    start : equations at the state if available. With an infinite cost, the first step is always
        accepted. No step is then tried whose predicted gain is below `atol`; without `start`, the
        last step is tried before the descent ends.
    atol : gain that ends the descent.
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
        jnp.asarray(progress.step.promised),
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
    """Equations at a state; traced once for the whole descent."""
    return problem.equations(state)


class Damping(NamedTuple):
    """Damping of the head, and of each block."""

    head: Float[ArrayLike, ""]
    blocks: Float[ArrayLike, "b"]


class ArrowStep(NamedTuple):
    """A proposed step.

    Attributes
    ----------
    head, blocks : step of the head and of the blocks.
    promised : gain predicted by the equations.
    follows : whether each block takes part.
    """

    head: Float[Array, "h"]
    blocks: Float[Array, "b w"]
    promised: Float[ArrayLike, ""]
    follows: Bool[ArrayLike, "b"]


class ArrowDescent(optx.AbstractDescent):
    """Damped Gauss-Newton step of a block arrow.

    Its state is the present point with the equations there.

    Attributes
    ----------
    retract : function of (state, head, blocks) that returns the state after a step.
    block_costs : function that returns the cost of each block of a state, for separate dampings;
        else None.
    """

    retract: Callable[..., Any]
    block_costs: Callable[..., Any] | None

    def init(self, y: Any, f_info_struct: Any) -> Any:
        """Equations with an infinite cost and without information."""
        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), f_info_struct)
        return y, zeros._replace(cost=jnp.full_like(zeros.cost, jnp.inf), details=None)

    def query(self, y: Any, f_info: ArrowEquations, state: Any) -> Any:
        """Set the point of the next step, with the equations there."""
        return y, f_info

    def step(self, step_size: Any, state: Any) -> tuple[ArrowStep, optx.RESULTS]:
        """Step with the damping `step_size`; blocks whose cost it would raise do not move."""
        y, equations = state
        solver = BlockArrowSolver(step_size.head + FLOOR_DAMPING, step_size.blocks)
        factored, gradient = solver.init(equations.information, {}), equations.gradient
        solution = lx.linear_solve(
            equations.information, gradient, solver, state=factored, throw=False
        )
        head, blocks = jax.tree.map(jnp.negative, solution.value)
        if self.block_costs is None:
            promised = -(gradient[0] @ head) - jnp.sum(gradient[1] * blocks)
            step = ArrowStep(head, blocks, promised, jnp.ones(len(blocks), bool))
            return step, optx.RESULTS.successful
        block_costs, with_and_without = (
            self.block_costs,
            jnp.stack([blocks, jnp.zeros_like(blocks)]),
        )
        cost_with, cost_without = jax.vmap(
            lambda block_steps: block_costs(self.retract(y, head, block_steps))
        )(with_and_without)
        follows = cost_with <= cost_without
        promised = -factored.elimination.reduced_side(gradient) @ head
        step = ArrowStep(head, jnp.where(follows[:, None], blocks, 0.0), promised, follows)
        return step, optx.RESULTS.successful


class _SearchState(NamedTuple):
    """State of the search.

    damping : of the next step. tried : the step that is evaluated. risen : whether the present
        point is above the best state. done : whether the descent may end.
    """

    damping: Damping
    tried: ArrowStep
    risen: Bool[ArrayLike, ""]
    done: Bool[ArrayLike, ""]


class WatchdogSearch(optx.AbstractSearch):
    """Accept steps that reduce the cost, and near the minimum one that raises it if the next
    compensates.

    A successful step divides the damping by ten, another one multiplies it. Source: Chamberlain et
    al., "The watchdog technique for forcing convergence in algorithms for constrained optimization"
    (1982).

    Attributes
    ----------
    first_damping : of the first step.
    atol : gain that ends the descent.
    is_separable : whether blocks have separate dampings.
    """

    first_damping: Float[ArrayLike, ""]
    atol: ScalarLike
    is_separable: bool = eqx.field(static=True)

    def init(self, y: Any, f_info_struct: Any) -> _SearchState:
        """State before the first step: a step of zero with no predicted gain."""
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
        """Return (next damping, whether the tried state is accepted, success, state of the search).

        f_info, f_eval_info : equations at the best state, and at the tried one.
        """
        damping, step, risen, _ = state
        gain = f_info.cost - f_eval_info.cost
        better = f_eval_info.cost <= f_info.cost
        rises = ~better & ~risen & (step.promised < _NEAR) & jnp.isfinite(f_eval_info.cost)
        stuck = (damping.head * 10 > MOST_DAMPING) | (step.promised < 1e-3 * self.atol)
        slow_blocks = len(step.blocks) / BLOCKS_THAT_CREEP if self.is_separable else 0.0
        has_converged = (step.promised < self.atol) & (gain < self.atol * (1 + slow_blocks))
        factor = jnp.where(better, 0.1, jnp.where(rises, 1.0, 10.0))
        block_factor = jnp.where(step.follows, factor, 10.0)
        damping = Damping(
            jnp.maximum(damping.head * factor, LEAST_DAMPING),
            jnp.clip(damping.blocks * block_factor, LEAST_DAMPING, MOST_DAMPING),
        )
        done = jnp.where(better, has_converged, stuck)
        accepted = jnp.asarray(better | (rises & ~stuck))
        return damping, accepted, optx.RESULTS.successful, _SearchState(damping, step, rises, done)


class _Progress(eqx.Module):
    """State of the minimiser.

    Attributes
    ----------
    best, at_best : best state so far, and the equations there.
    here : present point of the descent.
    search : state of the search.
    step : next step to try.
    steps : number of tried steps.
    is_best : whether the last tried state is the best one.
    done : whether the descent has ended.
    """

    best: Any
    at_best: ArrowEquations
    here: Any
    search: _SearchState
    step: ArrowStep
    steps: Int[Array, ""]
    is_best: Bool[Array, ""]
    done: Bool[Array, ""]


class ArrowMinimiser(optx.AbstractMinimiser[Any, ArrowEquations, _Progress]):
    """Minimiser that combines a descent and a search.

    The minimised function returns its cost together with its `ArrowEquations`. The compiled
    program contains it only once, after each step, so that it compiles faster. Without equations
    at the start, a first step of zero provides them.

    Attributes
    ----------
    most_steps : largest number of steps.
    start : equations at the start. With them, steps with a small predicted gain are not tried.
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
        """State at the start, with the first step if equations are given."""
        point, search = self.descent.init(y, aux_struct), self.search.init(y, aux_struct)
        step, done = search.tried, jnp.asarray(False)
        if self.start is not None:
            point = self.descent.query(y, self.start._replace(details=None), point)
            step, _ = self.descent.step(search.damping, point)
            done = jnp.isfinite(self.start.cost) & (step.promised < self.search.atol)
        search = search._replace(tried=step)
        return _Progress(y, point[1], point, search, step, jnp.asarray(0), done, done)

    def step(self, fn, y, args, options, state, tags) -> tuple[Any, _Progress, ArrowEquations]:
        """Evaluate a step, and propose the next one."""
        tried = self.descent.retract(y, state.step.head, state.step.blocks)
        _, evaluated = fn(tried, args)
        evaluated_equations = evaluated._replace(details=None)
        damping, accepted, _, search = self.search.step(
            state.steps == 0, state.best, tried, state.at_best, evaluated_equations, state.search
        )
        better = jnp.asarray(evaluated_equations.cost <= state.at_best.cost)
        best, at_best = _where(better, (tried, evaluated_equations), (state.best, state.at_best))
        point = _where(accepted, (tried, evaluated_equations), (best, at_best))
        step, _ = self.descent.step(damping, self.descent.query(point[0], point[1], state.here))
        steps = state.steps + 1
        done = search.done | (steps >= self.most_steps)
        if self.start is not None:
            done |= better & (step.promised < self.search.atol)
        search = search._replace(tried=step)
        progress = _Progress(best, at_best, point, search, step, steps, better, jnp.asarray(done))
        return point[0], progress, evaluated

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """True if the descent has ended; it failed if no cost was finite."""
        failed = state.done & ~jnp.isfinite(state.at_best.cost)
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return state.done, result

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[Any, ArrowEquations, dict[str, Any]]:
        """Best state, and the equations of the last evaluated state."""
        return state.best, aux, {}


def _where(condition: Bool[ArrayLike, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), yes, no)


def gauss_newton_gain(equations: ArrowEquations) -> Float[Array, ""]:
    """Predicted reduction of the cost by an undamped step, with linearised residuals."""
    solver = BlockArrowSolver(FLOOR_DAMPING)
    solved = lx.linear_solve(equations.information, equations.gradient, solver, throw=False).value
    (head, blocks), (head_gradient, block_gradient) = solved, equations.gradient
    return head_gradient @ head + jnp.sum(block_gradient * blocks)
