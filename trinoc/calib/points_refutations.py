"""What points refute of what was held of their camera."""

from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.lens_of_points import (
    OPEN_SHARE,
    ROUNDING_PX,
    PointResiduals,
    lens_parameter_names,
    with_lens_parameters_free,
)
from trinoc.calib.messages import lens_strain_sentence
from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.problem.rao_test import RaoTest
from trinoc.calib.problem.robust_fit import errors_px, fit_places
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.lenses.skewed import SKEW
from trinoc.geometry.pose import PoseModel

# numerical: fits, after which the noise, and with it the weight of a prior, is what it is.
_PRIOR_ROUNDS = 3
_AIM = ("aim",)


def list_refutations(
    problem: Problem, names: Collection[str], model: PoseModel, held: Float[np.ndarray, "q r"]
) -> tuple[str, ...]:
    """Sentences on what the points refute of what was held; none where they refute nothing.

    problem : the fit with `names` free. held : change of the lens's parameters for a sigma of each
        error that is not fitted; what has none is exact.
    """
    every = lens_parameter_names(problem)
    uncertain = {name for name, row in zip(every, held, strict=True) if row.any()}
    if np.sum(errors_px(problem)[0] ** 2) < ROUNDING_PX**2 * 2 * len(problem.views[0].used):
        return ()
    strain, open_ = 0.0, {*names, *uncertain}
    if uncertain:
        problem, strain = _fit_under_prior(problem, names, held)
    points = PointResiduals.of(with_lens_parameters_free(problem, open_))
    causes = {
        tuple(every[row] for row in rows): rows
        for group in _groups(problem)
        if (rows := [every.index(name) for name in group if name not in open_])
    }
    if model is PoseModel.AIMED:
        first = problem.chart.camera_rows(0).start + model.size
        causes[_AIM] = [first, first + 1]
    tests = {cause: points.judge(columns) for cause, columns in causes.items()}
    notes = []
    if tests:
        cause = min(tests, key=lambda cause: points.rank(tests[cause]))
        test = tests[cause]
        if points.chance(test) * len(tests) < TUNING.answer.chance:
            notes.append(_sentence(problem, cause, causes[cause], test, points))
    if strain > TUNING.answer.strain_sigmas:
        sentence = lens_strain_sentence(strain)
        notes.append(sentence[0].upper() + sentence[1:])
    return tuple(notes)


def _groups(problem: Problem) -> Iterator[tuple[str, ...]]:
    """What is asked for together: of the lens's parameters those that are fitted together."""
    lens = problem.state.lenses
    yield from (AFFINE_PARAMETERS[:2], AFFINE_PARAMETERS[2:])
    if SKEW in lens.parameter_names:
        yield (SKEW,)
    for low, high in pairwise(lens.coefficient_counts):
        group = lens.coefficient_names[low:high]
        yield tuple(name for name in group if name not in lens.never_fitted)


def _sentence(
    problem: Problem,
    cause: tuple[str, ...],
    columns: Sequence[int],
    test: RaoTest,
    points: PointResiduals,
) -> str:
    """What explains most of the residuals, and by how much it is off."""
    chart = problem.chart
    unit = chart.unit_mm if cause is _AIM else np.asarray(chart.lens_scale)[0][columns]
    off = unit * test.step
    sigma = unit * np.sqrt(np.diag(test.with_noise(points.noise_variance(test)).covariance))
    if cause is _AIM:
        return (
            f"The optical axis misses the origin by ({off[0]:.3g}, {off[1]:.3g}) +- "
            f'({sigma[0]:.1g}, {sigma[1]:.1g}) mm: use pose_model="aim-free".'
        )
    by = ", ".join(f"{n} by {o:+.3g} +- {s:.1g}" for n, o, s in zip(cause, off, sigma))
    return (
        f"The points ask for another lens than was held, above all in {by}: free "
        f"{', '.join(cause)}, or see that places and pixels are those of one camera."
    )


class _UnderPrior(NamedTuple):
    """A fit with the lens's uncertain parameters free under their covariance. strain : the largest
    of their errors, of as many sigmas."""

    problem: Problem
    strain: float


def _fit_under_prior(
    problem: Problem, names: Collection[str], held: Float[np.ndarray, "q r"]
) -> _UnderPrior:
    """held : as `list_refutations` has it. The problem's chart stays as it is."""
    chart, (view,) = problem.chart, problem.views
    count, size = chart.lens_shape
    scale, mean = np.asarray(chart.lens_scale)[0], np.asarray(lens_number(problem, 0).parameters)
    directions, sizes, _ = np.linalg.svd(held / scale[:, None], full_matrices=False)
    is_open = sizes > OPEN_SHARE * sizes[0]
    steps = int(is_open.sum())
    factor = scale[:, None] * directions[:, is_open] * sizes[is_open]
    inverse = np.linalg.pinv(factor / scale[:, None]) / scale
    rows = [row for row, name in enumerate(lens_parameter_names(problem)) if name in names]
    basis, means = np.array(chart.lens_basis), np.array(chart.lens_mean)
    basis[0] = 0.0
    basis[0][:, :steps] = factor
    basis[0][rows, steps + np.arange(len(rows))] = scale[rows]
    means[0] = mean
    free = np.array(chart.free)
    free[:size] = np.arange(size) < steps + len(rows)
    freedom = max(2 * int(view.used.sum()) - int(free.sum()) + steps, 1)
    fitted = problem
    for _ in range(_PRIOR_ROUNDS):
        # Residuals are in px, whose variance the prior is to be weighed by.
        variance = float(np.sum(errors_px(fitted)[0][view.used] ** 2)) / freedom
        information = np.zeros((count, size, size))
        information[0] = variance * inverse.T @ inverse
        opened = eqx.tree_at(
            lambda c: (c.lens_basis, c.lens_mean, c.lens_information, c.free),
            chart,
            (basis, means, information, free),
        )
        fitted, _ = fit_places(fitted._replace(chart=opened))
    errors = inverse @ (np.asarray(lens_number(fitted, 0).parameters) - mean)
    return _UnderPrior(fitted._replace(chart=chart), float(np.abs(errors).max()))
