"""The two compiled programs of the fit of an image: steps of the fit, and reweighting."""

from jaxtyping import Float, Int

from trinoc.calib.photometric.equations import ImageProblem, weigh_image
from trinoc.calib.photometric.unknowns import ImageState
from trinoc.calib.problem.solver import ArrowEquations, Solution, descend
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit


def fit_image(
    problem: ImageProblem,
    state: ImageState,
    start: ArrowEquations,
    first_damping: Float[ArrayLike, ""],
    most_steps: Int[ArrayLike, ""],
    atol: Float[ArrayLike, ""],
) -> Solution[ImageState]:
    """Minimise the chi-square of one image by Levenberg-Marquardt steps.

    Parameters
    ----------
    problem : pixels of the image with their weights, and priors.
    state : initial values of the unknowns.
    start : least-squares equations of all unknowns at `state`.
    first_damping : initial damping.
    most_steps : largest number of steps.
    atol : the fit ends if the predicted decrease of chi-square by the next step is smaller.
    """
    return descend(
        problem, state, first_damping, problem.remove_fixed(start), atol=atol, most_steps=most_steps
    )


run_fit = kept_jit(fit_image)
weigh = kept_jit(weigh_image)
