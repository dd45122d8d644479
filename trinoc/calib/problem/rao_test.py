"""Rao's score test of fixed parameters, without another fit."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import scipy
from jaxtyping import Bool, Float

from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.problem import Problem, lens_number, with_wider_lenses
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.lenses.registry import lens_model, widen_lens
from trinoc.numerics.tails import chi_square_tail

# numerical: smallest share of the information on fixed parameters that remains with the fitted ones
# eliminated; smaller shares are rounding.
_LEAST_SHARE = 1e-10
# numerical: the same for fitted parameters: some lengths and board displacements are undetermined.
_OPEN_SHARE = 1e-11
Group = TypeVar("Group")


class RaoTest(NamedTuple):
    """Score test of fixed parameters: the effect of freeing them, computed without a new fit.

    Attributes
    ----------
    chi_square : reduction of the residuals' chi-square if the parameters were free.
    freedom : number of directions of the parameters that the residuals determine.
    step : (k,) change of the parameters if they were free.
    covariance : (k, k) covariance of `step` if the residuals have a variance of 1; zero in
        undetermined directions.
    """

    chi_square: float
    freedom: int
    step: Float[np.ndarray, "k"]
    covariance: Float[np.ndarray, "k k"]

    @property
    def p_value(self) -> float:
        """Probability of such a reduction by noise; uniformly distributed if the fixed values are
        right.
        """
        return float(chi_square_tail(self.chi_square, self.freedom)) if self.freedom else 1.0

    def with_noise(self, variance: float) -> "RaoTest":
        """Test for residuals with this noise variance, in squared sigmas."""
        return self._replace(
            chi_square=self.chi_square / variance, covariance=variance * self.covariance
        )

    def noise_variance(self, squared: float, freedom: float) -> float:
        """Variance of the residuals if the fixed parameters were free.

        squared, freedom : sum of the squared residuals of the fit, and its degrees of freedom.
        """
        return max(squared - self.chi_square, 1e-12 * squared) / (freedom - self.freedom)

    def f_test_p_value(self, squared: float, freedom: float) -> float:
        """`p_value` with the noise variance estimated from the residuals (F test)."""
        if not self.freedom or freedom - self.freedom < 1:
            return 1.0
        return self.p_value_with_noise(
            self.noise_variance(squared, freedom), freedom - self.freedom
        )

    def p_value_with_noise(self, variance: float, freedom: float) -> float:
        """`p_value` with a noise variance that was estimated with so many degrees of freedom."""
        ratio = self.chi_square / max(self.freedom, 1) / variance
        return float(scipy.special.fdtrc(self.freedom, freedom, ratio)) if self.freedom else 1.0


def detectable_sigmas(chance: float, freedom: int, power: float = TUNING.answer.power) -> float:
    """Size of an error, in sigmas, that a test detects with this power.

    chance : significance level of the test.

    W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission,
    1968, by the noncentral chi-square distribution.
    """
    limit = scipy.special.chdtri(freedom, chance)
    return float(np.sqrt(scipy.special.chndtrinc(limit, freedom, 1.0 - power)))


def score_test(
    information: Float[np.ndarray, "k k"],
    gradient: Float[np.ndarray, "k"],
    total_information: Float[np.ndarray, "k"],
) -> RaoTest:
    """Score test from information and gradient with the fitted parameters eliminated.

    information : (k, k) on the fixed parameters. gradient : (k,) of half of chi-square.
        total_information : (k,) on each parameter without the elimination; sets the scale.
    """
    scale = np.sqrt(np.maximum(total_information, 1e-300))
    shares, directions = np.linalg.eigh(information / np.outer(scale, scale))
    shares, directions = (part[..., shares > _LEAST_SHARE] for part in (shares, directions))
    gradient_along = directions.T @ (gradient / scale)
    steps_along = directions / shares / scale[:, None]
    return RaoTest(
        chi_square=float(np.sum(gradient_along**2 / shares)),
        freedom=len(shares),
        step=-steps_along @ gradient_along,
        covariance=steps_along @ (directions / scale[:, None]).T,
    )


class FixedScore(NamedTuple):
    """Score of all fixed parameters of a fit, with the fitted parameters eliminated.

    Attributes
    ----------
    information : (k, k) information on the fixed parameters.
    gradient : (k,) gradient of half of chi-square.
    total_information : (k,) information on each parameter without the elimination.
    squared, freedom : sum of the squared residuals, and its degrees of freedom.
    are_exact : whether the residuals are rounding errors, which contradict nothing.
    """

    information: Float[np.ndarray, "k k"]
    gradient: Float[np.ndarray, "k"]
    total_information: Float[np.ndarray, "k"]
    squared: float
    freedom: float
    are_exact: bool

    def test(self, columns: Sequence[int]) -> RaoTest:
        """Score test of some of the parameters. columns : their indices."""
        rows = np.asarray(columns)
        return score_test(
            self.information[np.ix_(rows, rows)], self.gradient[rows], self.total_information[rows]
        )

    def p_value(self, test: RaoTest) -> float:
        """Probability of a test's reduction by noise, with the noise of the residuals."""
        return 1.0 if self.are_exact else test.f_test_p_value(self.squared, self.freedom)

    def noise_variance(self, test: RaoTest) -> float:
        """Variance of the residuals if the tested parameters were free."""
        return test.noise_variance(self.squared, self.freedom)

    def rank(self, test: RaoTest) -> tuple[float, float]:
        """Sort key of tests; the most significant test has the smallest key.

        The key is the p-value, then the negative reduction per direction, for p-values that
        underflow.
        """
        return self.p_value(test), -test.chi_square / max(test.freedom, 1)

    def strongest(self, groups: Mapping[Group, Sequence[int]]) -> Group | None:
        """Group of parameters with the most significant test. groups : columns of each."""
        return min(groups, key=lambda group: self.rank(self.test(groups[group])), default=None)

    def with_freed(self, columns: Sequence[int]) -> "FixedScore":
        """Score after these parameters were freed, to first order."""
        test = self.test(columns)
        return self._replace(
            information=self.information
            - self.information[:, columns] @ test.covariance @ self.information[columns],
            gradient=self.gradient + self.information[:, columns] @ test.step,
            squared=max(self.squared - test.chi_square, 1e-12 * self.squared),
            freedom=self.freedom - test.freedom,
        )


def is_refuted(p_value: float, tests: int, limit: float = TUNING.answer.chance) -> bool:
    """True if a score test is significant after the Bonferroni correction.

    p_value : of the most significant test. tests : their number. limit : largest p-value of all.
    """
    return p_value * tests < limit


def score_of_fixed(
    information: Information, fixed: Bool[np.ndarray, "f"]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Score of fixed parameters as (information, gradient, total_information) of `FixedScore`.

    fixed : (f,) mask of `information.free` that was fixed.

    The prior on the board is excluded: a test then holds for any board.
    """
    rows = information.free
    total = information.shot_information.sum(axis=0)[np.ix_(rows, rows)]
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    total = total / np.outer(scale, scale)
    gradient = information.gradients.sum(axis=0)[rows] / scale
    explained = total[np.ix_(fixed, ~fixed)] @ np.linalg.pinv(
        total[np.ix_(~fixed, ~fixed)], rcond=_OPEN_SHARE, hermitian=True
    )
    remaining = total[np.ix_(fixed, fixed)] - explained @ total[np.ix_(~fixed, fixed)]
    unit = scale[fixed]
    return (
        remaining * np.outer(unit, unit),
        unit * (gradient[fixed] - explained @ gradient[~fixed]),
        unit**2,
    )


def score_of_residuals(
    extra: Float[np.ndarray, "n k"],
    residual: Float[np.ndarray, "n"],
    base: Float[np.ndarray, "n f"],
    root: Float[np.ndarray, "f f"],
    freedom: float,
) -> FixedScore:
    """Score of fixed unknowns from residuals in sigmas with `freedom` degrees of freedom.

    extra, base : derivatives of the residuals by the fixed and by the fitted unknowns.
    root : R of the information R^T R on the fitted unknowns, with priors and other images.
    """
    fitted = scipy.linalg.solve_triangular(root, base.T @ extra, trans=1)
    return FixedScore(
        information=extra.T @ extra - fitted.T @ fitted,
        gradient=extra.T @ residual,
        total_information=np.sum(extra**2, axis=0),
        squared=float(residual @ residual),
        freedom=freedom,
        are_exact=False,
    )


def rao_test(information: Information, tested: Bool[np.ndarray, "f"]) -> RaoTest:
    """Score test of some of the free parameters, as if they had been fixed and the others fitted.

    tested : (f,) mask of `information.free` that is tested.

    The effect of the others is eliminated from gradient and covariance. For k parameters, fewer
    than k directions may remain.
    """
    return score_test(*score_of_fixed(information, tested))


def rational_lens_test(
    problem: Problem, image_sizes_px: Sequence[tuple[int, int]], variance_factor: float
) -> RaoTest:
    """Score test of the rational lens at the end of a fit of Brown and Conrady's lens.

    The latter is the rational lens with k4 = k5 = k6 = 0.

    image_sizes_px : (width, height) of the images of each lens.
    """
    model, count = lens_model("rational"), problem.parametrization.lens_shape[0]
    lenses = [widen_lens(lens_number(problem, k), model) for k in range(count)]
    return wider_lens_test(
        problem, with_wider_lenses(problem, lenses, image_sizes_px), variance_factor
    )


def wider_lens_test(problem: Problem, wider: Problem, variance_factor: float) -> RaoTest:
    """Score test of the additional lens parameters of `wider`, which has them fixed at their
    default.

    wider : the same problem `with_wider_lenses`.
    """
    information = compute_information(wider)
    _, size = problem.parametrization.lens_shape
    _, wider_size = wider.parametrization.lens_shape
    column = np.arange(len(wider.free))
    is_added = (column < wider.slices.lenses.stop) & (column % wider_size >= size)
    test = rao_test(information, is_added[information.free])
    return test.with_noise(variance_factor)
