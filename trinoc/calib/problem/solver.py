"""Levenberg and Marquardt's method for everything whose normal equations are a block arrow.

Lenses, cameras and boards share few unknowns (the head), and every shot or line has a few of its
own (a block); a picture's pose and look are a head, the light about each circle a block. The state
is a point on a manifold: charts are laid anew at every point, and the Jacobian is never formed.
`ArrowDescent` proposes steps, `WatchdogSearch` accepts or refuses them, and `ArrowMinimiser` runs
both. Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000).
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
    """Gauss-Newton equations at a state: `information` times the step is minus `gradient`.

    Fields
    ------
    cost : of the state.
    information, gradient : J^T W J, and J^T W r, half the gradient of the cost, over the steps of
        the head (h,) and of the blocks (b, w).
    details : whatever else the problem computes on the way; a descent returns that of the last
        state that it evaluated.
    """

    cost: Float[ArrayLike, ""]
    information: BlockArrow
    gradient: tuple[Float[ArrayLike, "h"], Float[ArrayLike, "b w"]]
    details: Any = None


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

    def block_costs(self, state: State) -> Float[ArrayLike, "b"]:
        """What of the cost depends on each block."""
        return self.costs(state).blocks

    def cost(self, state: State) -> Float[ArrayLike, ""]:
        """Their sum."""
        return self.costs(state).total


class Solution(eqx.Module, Generic[State]):
    """End of a descent.

    Fields
    ------
    state, cost : the best state and its cost.
    steps : number of steps that were tried.
    converged : whether the descent ended by itself.
    promised : gain that the next step promises.
    details : those of the equations at `state`, where `has_details`: where the state that was
        evaluated last is the best one.
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

    first_damping : of the first step, over the diagonal of the equations; that of the problem
        unless given. With `LEAST_DAMPING` it is Gauss and Newton's, for a start so near that it
        gains: directions that are known a million times less well than others move at once.

    Directions that nothing determines keep their start. Differentiating it raises: a state has
    more numbers than freedoms.
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
    """Return the best state after steps from a start, as a part of a compiled program.

    Parameters
    ----------
    start : equations at the state where they are known; with an infinite cost the first step is
        accepted whatever it gains. Then no step is tried that promises less than `atol`; else the
        last one is tried before the descent ends.
    atol : gain that ends the descent.
    most_steps : how many are tried at most.
    """

    def cost_and_equations(state: Any, problem: Any) -> tuple[Any, ArrowEquations]:
        equations = _equations(problem, state)
        return equations.cost, equations

    # Without equations the first step is of nothing, and gains: it divides the damping by ten.
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
        progress.steps - int(start is None),  # the first is of nothing
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
    """Traced once for the whole descent."""
    return problem.equations(state)


class Damping(NamedTuple):
    """Damping of the head, and of each block."""

    head: Float[ArrayLike, ""]
    blocks: Float[ArrayLike, "b"]


class ArrowStep(NamedTuple):
    """A proposed step.

    Fields
    ------
    head, blocks : step of the head and of the blocks.
    promised : gain that the equations promise.
    follows : whether each block takes part.
    """

    head: Float[Array, "h"]
    blocks: Float[Array, "b w"]
    promised: Float[ArrayLike, ""]
    follows: Bool[ArrayLike, "b"]


class ArrowDescent(optx.AbstractDescent):
    """Damped Gauss-Newton step of a block arrow.

    Its state is the point that it steps from, with the equations there.

    Fields
    ------
    retract : the state after a step, of (state, head, blocks).
    block_costs : the cost of each block, of a state, where blocks step by themselves; else None.
    """

    retract: Callable[..., Any]
    block_costs: Callable[..., Any] | None

    def init(self, y: Any, f_info_struct: Any) -> Any:
        """Equations of an infinite cost, without information."""
        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), f_info_struct)
        return y, zeros._replace(cost=jnp.full_like(zeros.cost, jnp.inf), details=None)

    def query(self, y: Any, f_info: ArrowEquations, state: Any) -> Any:
        """Step from here."""
        return y, f_info

    def step(self, step_size: Any, state: Any) -> tuple[ArrowStep, optx.RESULTS]:
        """The step with the damping `step_size`; blocks that it would not serve stay."""
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
        block_costs, both = self.block_costs, jnp.stack([blocks, jnp.zeros_like(blocks)])
        moved, stayed = jax.vmap(lambda own: block_costs(self.retract(y, head, own)))(both)
        follows = moved <= stayed
        promised = -factored.elimination.reduced_side(gradient) @ head
        step = ArrowStep(head, jnp.where(follows[:, None], blocks, 0.0), promised, follows)
        return step, optx.RESULTS.successful


class _SearchState(NamedTuple):
    """Damping of the next step, the step that is tried, whether the descent stands above the best
    state, and whether it may end."""

    damping: Damping
    tried: ArrowStep
    risen: Bool[ArrayLike, ""]
    done: Bool[ArrayLike, ""]


class WatchdogSearch(optx.AbstractSearch):
    """Accepts a step that gains, and near the minimum one that rises, if the next makes up for it.

    A step that gains divides the damping by ten, one that does not multiplies it. Source:
    Chamberlain et al., "The watchdog technique for forcing convergence in algorithms for
    constrained optimization" (1982).

    Fields
    ------
    first_damping : of the first step.
    atol : gain that ends the descent.
    is_separable : whether blocks step by themselves.
    """

    first_damping: Float[ArrayLike, ""]
    atol: ScalarLike
    is_separable: bool = eqx.field(static=True)

    def init(self, y: Any, f_info_struct: Any) -> _SearchState:
        """Nothing tried yet: a step of nothing, which promises nothing."""
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
        """(the next damping, whether to go on from the tried state, success, the state).

        f_info, f_eval_info : at the best state, and at the one that was tried.
        """
        damping, step, risen, _ = state
        gain = f_info.cost - f_eval_info.cost
        better = f_eval_info.cost <= f_info.cost
        rises = ~better & ~risen & (step.promised < _NEAR) & jnp.isfinite(f_eval_info.cost)
        stuck = (damping.head * 10 > MOST_DAMPING) | (step.promised < 1e-3 * self.atol)
        creeping = len(step.blocks) / BLOCKS_THAT_CREEP if self.is_separable else 0.0
        still = (step.promised < self.atol) & (gain < self.atol * (1 + creeping))
        factor = jnp.where(better, 0.1, jnp.where(rises, 1.0, 10.0))
        of_blocks = jnp.where(step.follows, factor, 10.0)
        damping = Damping(
            jnp.maximum(damping.head * factor, LEAST_DAMPING),
            jnp.clip(damping.blocks * of_blocks, LEAST_DAMPING, MOST_DAMPING),
        )
        done = jnp.where(better, still, stuck)
        accepted = jnp.asarray(better | (rises & ~stuck))
        return damping, accepted, optx.RESULTS.successful, _SearchState(damping, step, rises, done)


class _Progress(eqx.Module):
    """State of the minimiser.

    Fields
    ------
    best, at_best : the best state so far, and the equations there.
    here : point of the descent.
    search : state of the search.
    step : what is tried next.
    steps : how many were tried.
    is_best : whether the state that was tried last is the best one.
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
    """Runs a descent and a search, from equations that the function returns beside its cost.

    Of the function there is one copy in the program, after a step: without equations at the start,
    a first step of nothing finds them.

    Fields
    ------
    most_steps : how many are tried at most.
    start : equations at the start, and the sign that steps of little promise are not tried.
    """

    descent: ArrowDescent
    search: WatchdogSearch
    most_steps: Int[ArrayLike, ""]
    start: ArrowEquations | None
    # optimistix wants these; the search's `atol` alone ends the steps: a chi-square has a scale of
    # its own.
    rtol: ClassVar[float] = 0.0
    atol: ClassVar[float] = CONVERGED_GAIN
    norm: ClassVar[Callable[[PyTree], Float[Array, ""]]] = staticmethod(optx.max_norm)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _Progress:
        """At the start, with the first step from the equations there."""
        here, search = self.descent.init(y, aux_struct), self.search.init(y, aux_struct)
        step, done = search.tried, jnp.asarray(False)
        if self.start is not None:
            here = self.descent.query(y, self.start._replace(details=None), here)
            step, _ = self.descent.step(search.damping, here)
            done = jnp.isfinite(self.start.cost) & (step.promised < self.search.atol)
        search = search._replace(tried=step)
        return _Progress(y, here[1], here, search, step, jnp.asarray(0), done, done)

    def step(self, fn, y, args, options, state, tags) -> tuple[Any, _Progress, ArrowEquations]:
        """Try a step, and propose the next one."""
        tried = self.descent.retract(y, state.step.head, state.step.blocks)
        _, evaluated = fn(tried, args)
        there = evaluated._replace(details=None)
        damping, accepted, _, search = self.search.step(
            state.steps == 0, state.best, tried, state.at_best, there, state.search
        )
        better = jnp.asarray(there.cost <= state.at_best.cost)
        best, at_best = _where(better, (tried, there), (state.best, state.at_best))
        here = _where(accepted, (tried, there), (best, at_best))
        step, _ = self.descent.step(damping, self.descent.query(here[0], here[1], state.here))
        steps = state.steps + 1
        done = search.done | (steps >= self.most_steps)
        if self.start is not None:
            done |= better & (step.promised < self.search.atol)
        search = search._replace(tried=step)
        progress = _Progress(best, at_best, here, search, step, steps, better, jnp.asarray(done))
        return here[0], progress, evaluated

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Converged, or nowhere to go; it has failed where no cost was a number."""
        failed = state.done & ~jnp.isfinite(state.at_best.cost)
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return state.done, result

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[Any, ArrowEquations, dict[str, Any]]:
        """The best state, and the equations of the last one."""
        return state.best, aux, {}


def _where(condition: Bool[ArrayLike, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), yes, no)


def gauss_newton_gain(equations: ArrowEquations) -> Float[Array, ""]:
    """What an undamped step takes off the cost, to first order in the residuals."""
    solver = BlockArrowSolver(FLOOR_DAMPING)
    solved = lx.linear_solve(equations.information, equations.gradient, solver, throw=False).value
    (head, blocks), (of_head, of_blocks) = solved, equations.gradient
    return of_head @ head + jnp.sum(of_blocks * blocks)
