"""Rao's score test of fixed parameters: predicted effect of estimating them, without
another fit.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import scipy
from jaxtyping import Bool, Float

from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.problem import Problem, lens_of_index, with_wider_lenses
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
    """Rao's score test of fixed parameters: the predicted effect of estimating them, without a new
    fit.

    Attributes
    ----------
    chi_square : predicted reduction of the residuals' chi-square if the parameters were estimated.
    freedom : number of directions of these parameters that the residuals determine.
    step : (k,) predicted change of the k parameters.
    covariance : (k, k) covariance of `step` for residuals of variance 1; 0 in undetermined
        directions.
    """

    chi_square: float
    freedom: int
    step: Float[np.ndarray, "k"]
    covariance: Float[np.ndarray, "k k"]

    @property
    def p_value(self) -> float:
        """Probability that noise of variance 1 reduces chi-square at least as much.

        It is uniformly distributed if the fixed values are right.
        """
        return float(chi_square_tail(self.chi_square, self.freedom)) if self.freedom else 1.0

    def with_noise(self, variance: float) -> "RaoTest":
        """The same test for residuals whose noise has this variance, in squared point sigmas."""
        return self._replace(
            chi_square=self.chi_square / variance, covariance=variance * self.covariance
        )

    def noise_variance(self, squared: float, freedom: float) -> float:
        """Variance of the residuals if the tested parameters were estimated.

        squared : sum of the squared residuals of the fit.
        freedom : degrees of freedom of that sum.
        """
        return max(squared - self.chi_square, 1e-12 * squared) / (freedom - self.freedom)

    def f_test_p_value(self, squared: float, freedom: float) -> float:
        """p-value of an F test, in which the noise variance is estimated from the residuals.

        squared : sum of the squared residuals of the fit.
        freedom : degrees of freedom of that sum.
        """
        if not self.freedom or freedom - self.freedom < 1:
            return 1.0
        return self.p_value_with_noise(
            self.noise_variance(squared, freedom), freedom - self.freedom
        )

    def p_value_with_noise(self, variance: float, freedom: float) -> float:
        """p-value of an F test for a given estimate of the noise variance.

        freedom : degrees of freedom of that estimate.
        """
        ratio = self.chi_square / max(self.freedom, 1) / variance
        return float(scipy.special.fdtrc(self.freedom, freedom, ratio)) if self.freedom else 1.0


def detectable_sigmas(chance: float, freedom: int, power: float = TUNING.answer.power) -> float:
    """Size of an error, in sigmas, that a chi-square test detects with probability `power`.

    chance : significance level of the test.
    freedom : degrees of freedom of the test.

    References
    ----------
    W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission,
    1968 (noncentral chi-square distribution).
    """
    limit = scipy.special.chdtri(freedom, chance)
    return float(np.sqrt(scipy.special.chndtrinc(limit, freedom, 1.0 - power)))


def score_test(
    information: Float[np.ndarray, "k k"],
    gradient: Float[np.ndarray, "k"],
    total_information: Float[np.ndarray, "k"],
) -> RaoTest:
    """Score test of k fixed parameters from their normal equations.

    Parameters
    ----------
    information : (k, k) information about the fixed parameters, with the estimated parameters
        eliminated.
    gradient : (k,) gradient of half of chi-square, with the estimated parameters eliminated.
    total_information : (k,) diagonal of the information without the elimination. It scales the
        parameters, so that rounding errors are recognised.
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
    """Normal equations of the k fixed parameters of a fit, with the estimated parameters
    eliminated.

    Attributes
    ----------
    information : (k, k) information about the fixed parameters.
    gradient : (k,) gradient of half of chi-square with respect to the fixed parameters.
    total_information : (k,) diagonal of the information without the elimination.
    squared, freedom : sum of the squared residuals of the fit, and its degrees of freedom.
    are_exact : whether the residuals are only rounding errors. No test is then significant.
    """

    information: Float[np.ndarray, "k k"]
    gradient: Float[np.ndarray, "k"]
    total_information: Float[np.ndarray, "k"]
    squared: float
    freedom: float
    are_exact: bool

    def test(self, columns: Sequence[int]) -> RaoTest:
        """Score test of the fixed parameters with these indices, the others remaining fixed."""
        rows = np.asarray(columns)
        return score_test(
            self.information[np.ix_(rows, rows)], self.gradient[rows], self.total_information[rows]
        )

    def p_value(self, test: RaoTest) -> float:
        """p-value of a result of `test`, by an F test with the noise variance of the residuals."""
        return 1.0 if self.are_exact else test.f_test_p_value(self.squared, self.freedom)

    def noise_variance(self, test: RaoTest) -> float:
        """Variance of the residuals if the tested parameters were estimated."""
        return test.noise_variance(self.squared, self.freedom)

    def rank(self, test: RaoTest) -> tuple[float, float]:
        """Sort key of a test; the most significant test has the smallest key.

        The key is the p-value. If p-values are equal, for instance 0 by underflow, the negative
        reduction of chi-square per direction decides.
        """
        return self.p_value(test), -test.chi_square / max(test.freedom, 1)

    def strongest(self, groups: Mapping[Group, Sequence[int]]) -> Group | None:
        """Key of the parameter group with the most significant test; None without a group.

        groups : indices of the fixed parameters of each group.
        """
        return min(groups, key=lambda group: self.rank(self.test(groups[group])), default=None)

    def with_freed(self, columns: Sequence[int]) -> "FixedScore":
        """Normal equations of the fixed parameters after some of them were estimated, to first
        order.

        columns : indices of the parameters that are estimated now.
        """
        test = self.test(columns)
        return self._replace(
            information=self.information
            - self.information[:, columns] @ test.covariance @ self.information[columns],
            gradient=self.gradient + self.information[:, columns] @ test.step,
            squared=max(self.squared - test.chi_square, 1e-12 * self.squared),
            freedom=self.freedom - test.freedom,
        )


def is_refuted(p_value: float, tests: int, limit: float = TUNING.answer.chance) -> bool:
    """True if the most significant of several tests is significant (Bonferroni correction).

    p_value : smallest p-value.
    tests : number of tests.
    limit : significance level of all tests together.
    """
    return p_value * tests < limit


def score_of_fixed(
    information: Information, fixed: Bool[np.ndarray, "f"]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Information, (k, k), gradient, (k,), and total information, (k,), of k tested parameters.

    They are the fields of `FixedScore`.

    The prior of the board is excluded, so that a test is valid for any board.

    information : information of the shots. Its estimated parameters include the tested ones.
    fixed : (f,) which of the parameters `information.free` are tested; all others are eliminated.
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
    """Normal equations of k fixed unknowns, from residuals and Jacobians.

    Parameters
    ----------
    extra : (n, k) derivative of the residuals with respect to the fixed unknowns.
    residual : (n,) residuals of the fit, in sigmas.
    base : (n, f) derivative of the residuals with respect to the f estimated unknowns.
    root : (f, f) R of the information R^T R about the estimated unknowns. It includes priors and
        other images.
    freedom : degrees of freedom of the residuals.
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
    """Score test of some parameters, as if they had been fixed and all others estimated.

    tested : (f,) which of the parameters `information.free` are tested.
    """
    return score_test(*score_of_fixed(information, tested))


def rational_lens_test(
    problem: Problem, image_sizes_px: Sequence[tuple[int, int]], variance_factor: float
) -> RaoTest:
    """Score test of the coefficients k4, k5, k6 of the rational lens model, which a fit fixed at 0.

    problem : problem at the end of a fit of the Brown-Conrady model. That model is the rational
        model with k4 = k5 = k6 = 0.
    image_sizes_px : (width, height) of the images of each lens.
    variance_factor : noise variance of the residuals, in squared point sigmas.
    """
    model, count = lens_model("rational"), problem.parametrization.lens_shape[0]
    lenses = [widen_lens(lens_of_index(problem, k), model) for k in range(count)]
    return wider_lens_test(
        problem, with_wider_lenses(problem, lenses, image_sizes_px), variance_factor
    )


def wider_lens_test(problem: Problem, wider: Problem, variance_factor: float) -> RaoTest:
    """Score test of the lens parameters that a more general lens model adds.

    problem : problem at the end of a fit.
    wider : the same problem after `with_wider_lenses`; the additional parameters have default
        values.
    variance_factor : noise variance of the residuals, in squared point sigmas.
    """
    information = compute_information(wider)
    _, size = problem.parametrization.lens_shape
    _, wider_size = wider.parametrization.lens_shape
    column = np.arange(len(wider.free))
    is_added = (column < wider.slices.lenses.stop) & (column % wider_size >= size)
    test = rao_test(information, is_added[information.free])
    return test.with_noise(variance_factor)
