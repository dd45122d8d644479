"""The two compiled programs of the fit of a picture: its equations again, and steps."""

from jaxtyping import Float, Int

from trinoc.calib.photometric.equations import PictureProblem, weigh_picture
from trinoc.calib.photometric.unknowns import PictureState
from trinoc.calib.problem.solver import ArrowEquations, Solution, descend
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit


def fit_picture(
    problem: PictureProblem,
    state: PictureState,
    start: ArrowEquations,
    first_damping: Float[ArrayLike, ""],
    most_steps: Int[ArrayLike, ""],
    atol: Float[ArrayLike, ""],
) -> Solution[PictureState]:
    """Return the state after steps from one whose equations of all unknowns are known."""
    return descend(
        problem, state, first_damping, problem.hold(start), atol=atol, most_steps=most_steps
    )


run_fit = kept_jit(fit_picture)
weigh = kept_jit(weigh_picture)
