"""Rao's score test of parameters that a fit held fixed, without another fit."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from scipy.special import chdtri, chndtrinc, fdtrc

from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.problem import Problem, lens_number, with_wider_lenses
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.lenses.registry import lens_model, widen_lens
from trinoc.numerics.tails import chi_square_tail

# numerical: shares of the information on held parameters, after what is free has explained what it
# can, below which a direction cannot be distinguished from rounding.
_LEAST_SHARE = 1e-10
# numerical: the same of what is free: lengths, and shifts of the board's places, are open in part.
_OPEN_SHARE = 1e-11
Cause = TypeVar("Cause")


class RaoTest(NamedTuple):
    """Score test of parameters that were held fixed.

    Fields
    ------
    chi_square : reduction of the residuals' chi-square, were the parameters free.
    freedom : number of directions of the parameters that the residuals determine.
    step : (k,) change of the parameters, were they free.
    covariance : (k, k) of the step, for residuals in sigmas; zero in undetermined directions.
    """

    chi_square: float
    freedom: int
    step: Float[np.ndarray, "k"]
    covariance: Float[np.ndarray, "k k"]

    @property
    def chance(self) -> float:
        """Probability of such a reduction by noise; uniform where the held values are right."""
        return float(chi_square_tail(self.chi_square, self.freedom)) if self.freedom else 1.0

    def with_noise(self, variance: float) -> "RaoTest":
        """The test for residuals whose noise has this variance, in sigmas squared."""
        return self._replace(
            chi_square=self.chi_square / variance, covariance=variance * self.covariance
        )

    def noise_variance(self, squared: float, freedom: float) -> float:
        """Variance of the residuals, were the held parameters free.

        squared, freedom : sum of the residuals' squares in the fit, and its degrees of freedom.
        """
        return max(squared - self.chi_square, 1e-12 * squared) / (freedom - self.freedom)

    def chance_beside(self, squared: float, freedom: float) -> float:
        """`chance` with the noise estimated from the residuals, by an F test."""
        if not self.freedom or freedom - self.freedom < 1:
            return 1.0
        return self.chance_by(self.noise_variance(squared, freedom), freedom - self.freedom)

    def chance_by(self, variance: float, freedom: float) -> float:
        """`chance` with a variance of the noise that has so many degrees of freedom."""
        ratio = self.chi_square / max(self.freedom, 1) / variance
        return float(fdtrc(self.freedom, freedom, ratio)) if self.freedom else 1.0


def unseen_sigmas(chance: float, freedom: int, power: float = TUNING.answer.power) -> float:
    """Size of an error, in sigmas, that a test at this chance detects with this power.

    W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission,
    1968, by the noncentral chi-square law.
    """
    return float(np.sqrt(chndtrinc(chdtri(freedom, chance), freedom, 1.0 - power)))


def judge_pull(
    left: Float[np.ndarray, "k k"], pull: Float[np.ndarray, "k"], whole: Float[np.ndarray, "k"]
) -> RaoTest:
    """Score test from the information and the gradient that the fitted parameters leave.

    left : information on the held parameters. pull : gradient of half of chi-square by them. Of
    both, what the fitted parameters explain is taken off. whole : (k,) information on each, had
    nothing been fitted.
    """
    scale = np.sqrt(np.maximum(whole, 1e-300))
    shares, directions = np.linalg.eigh(left / np.outer(scale, scale))
    shares, directions = (part[..., shares > _LEAST_SHARE] for part in (shares, directions))
    along = directions.T @ (pull / scale)
    by_share = directions / shares / scale[:, None]
    return RaoTest(
        chi_square=float(np.sum(along**2 / shares)),
        freedom=len(shares),
        step=-by_share @ along,
        covariance=by_share @ (directions / scale[:, None]).T,
    )


class HeldScore(NamedTuple):
    """Score of all parameters that a fit held fixed, from which `judge` tests some.

    Fields
    ------
    left : (k, k) information on them, less what a change of the fitted parameters explains.
    pull : (k,) gradient of half of chi-square by them, likewise.
    whole : (k,) information on each, had nothing been fitted.
    squared, freedom : sum of the residuals' squares, and its degrees of freedom.
    are_exact : whether the residuals are rounding errors, which contradict nothing.
    """

    left: Float[np.ndarray, "k k"]
    pull: Float[np.ndarray, "k"]
    whole: Float[np.ndarray, "k"]
    squared: float
    freedom: float
    are_exact: bool

    def judge(self, columns: Sequence[int]) -> RaoTest:
        """The score test of some of the columns."""
        rows = np.asarray(columns)
        return judge_pull(self.left[np.ix_(rows, rows)], self.pull[rows], self.whole[rows])

    def chance(self, test: RaoTest) -> float:
        """Probability of a test's reduction, with the noise that the residuals show."""
        return 1.0 if self.are_exact else test.chance_beside(self.squared, self.freedom)

    def noise_variance(self, test: RaoTest) -> float:
        """Variance of the residuals, were the tested parameters free."""
        return test.noise_variance(self.squared, self.freedom)

    def rank(self, test: RaoTest) -> tuple[float, float]:
        """Sort key of tests, smallest for the strongest: the chance, then the negative reduction in
        each direction, for chances that are too small for floating point."""
        return self.chance(test), -test.chi_square / max(test.freedom, 1)

    def strongest(self, causes: Mapping[Cause, Sequence[int]]) -> Cause | None:
        """The cause that explains most of the residuals; causes : the columns of each."""
        return min(causes, key=lambda cause: self.rank(self.judge(causes[cause])), default=None)

    def with_freed(self, columns: Sequence[int]) -> "HeldScore":
        """The same after these columns were freed, too, to first order."""
        test = self.judge(columns)
        return self._replace(
            left=self.left - self.left[:, columns] @ test.covariance @ self.left[columns],
            pull=self.pull + self.left[:, columns] @ test.step,
            squared=max(self.squared - test.chi_square, 1e-12 * self.squared),
            freedom=self.freedom - test.freedom,
        )


def is_refuted(chance: float, causes: int, limit: float = TUNING.answer.chance) -> bool:
    """Whether a score test is significant after the Bonferroni correction for the causes tested.

    chance : p-value of the strongest of `causes` causes. limit : largest p-value of all together.
    """
    return chance * causes < limit


def explain_pull(
    information: Information, held: Bool[np.ndarray, "f"]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """`left`, `pull` and `whole`, as `HeldScore` has them, of what was not fitted.

    held : which of `information.free` that is.

    What was known of the board beforehand is left out: a test then holds for any board, whether or
    not it is as typical as that prior says.
    """
    rows = information.free
    whole = information.of_shot.sum(axis=0)[np.ix_(rows, rows)]
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    whole = whole / np.outer(scale, scale)
    pull = information.pulls.sum(axis=0)[rows] / scale
    explained = whole[np.ix_(held, ~held)] @ np.linalg.pinv(
        whole[np.ix_(~held, ~held)], rcond=_OPEN_SHARE, hermitian=True
    )
    left = whole[np.ix_(held, held)] - explained @ whole[np.ix_(~held, held)]
    unit = scale[held]
    return left * np.outer(unit, unit), unit * (pull[held] - explained @ pull[~held]), unit**2


def score_of_residuals(
    extra: Float[np.ndarray, "n k"],
    residual: Float[np.ndarray, "n"],
    base: Float[np.ndarray, "n f"],
    root: Float[np.ndarray, "f f"],
    freedom: float,
) -> HeldScore:
    """Score of unknowns that were held, from residuals in sigmas with `freedom` degrees.

    extra, base : derivatives of the residuals by these unknowns and by those that were fitted.
    root : R of the information R^T R on the latter, priors and other views included.
    """
    fitted = solve_triangular(root, base.T @ extra, trans=1)
    return HeldScore(
        left=extra.T @ extra - fitted.T @ fitted,
        pull=extra.T @ residual,
        whole=np.sum(extra**2, axis=0),
        squared=float(residual @ residual),
        freedom=freedom,
        are_exact=False,
    )


def rao_test(information: Information, held: Bool[np.ndarray, "f"]) -> RaoTest:
    """The pull at some of the free parameters, had they been held, and the others fitted.

    held : which of `information.free`.

    What the others can explain is taken off the pull and off its covariance: what is left of k
    parameters often has fewer directions than k.
    """
    return judge_pull(*explain_pull(information, held))


def rational_lens_test(
    problem: Problem, image_sizes_px: Sequence[tuple[int, int]], variance_factor: float
) -> RaoTest:
    """Test the rational lens against Brown and Conrady's, at the end of the latter's fit.

    Brown and Conrady's lens is the rational one with k4 = k5 = k6 = 0: the score test says whether
    the shots ask for other values.

    image_sizes_px : (width, height) of the pictures of each lens.
    """
    model, count = lens_model("rational"), problem.parametrization.lens_shape[0]
    lenses = [widen_lens(lens_number(problem, k), model) for k in range(count)]
    return wider_lens_test(
        problem, with_wider_lenses(problem, lenses, image_sizes_px), variance_factor
    )


def wider_lens_test(problem: Problem, wider: Problem, variance_factor: float) -> RaoTest:
    """Test whether the shots ask for the parameters that `wider` has beyond those of `problem`.

    wider : the same problem `with_wider_lenses`.
    """
    information = compute_information(wider)
    _, size = problem.parametrization.lens_shape
    _, wider_size = wider.parametrization.lens_shape
    column = np.arange(len(wider.free))
    is_added = (column < wider.slices.lenses.stop) & (column % wider_size >= size)
    test = rao_test(information, is_added[information.free])
    return test.with_noise(variance_factor)
