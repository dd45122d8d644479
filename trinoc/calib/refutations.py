"""Tests whether points or shots contradict lenses and aims that were given."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib import sentences
from trinoc.calib.lens_of_points import (
    ROUNDING_PX,
    fit_under_prior,
    lens_parameter_names,
    score_of_points,
    with_lens_parameters_free,
)
from trinoc.calib.problem.coefficients import free_of_lenses
from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.outcome import ShotScatter, shot_scatter
from trinoc.calib.problem.problem import (
    Problem,
    has_lens_prior,
    lens_of_index,
    with_free_parameters,
    with_wider_lenses,
)
from trinoc.calib.problem.rao_test import (
    FixedScore,
    RaoTest,
    detectable_sigmas,
    is_refuted,
    score_of_fixed,
)
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.variables import POSE_SIZE
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.skewed import SKEW, skew_lens
from trinoc.geometry.pose import PoseModel

_AIM = ("aim",)
# Number of a lens of the rig, and the names of its parameters that are tested together.
ParameterGroup = tuple[int, tuple[str, ...]]


def refutations_of_points(
    problem: Problem,
    names: Collection[str],
    model: PoseModel,
    lens_errors: Float[np.ndarray, "q r"],
) -> tuple[str, ...]:
    """Return the warnings that the points contradict parameters of lens or aim; empty if they do
    not.

    Parameters
    ----------
    problem : fit with only the lens parameters `names` estimated.
    names : names of the estimated lens parameters.
    model : estimated pose parameters. A fixed aim is tested.
    lens_errors : (q, r) change of the q lens parameters for one sigma of each of r errors of the
        given lens. Parameters with zeros are exact.
    """
    all_names = lens_parameter_names(problem)
    uncertain = {name for name, row in zip(all_names, lens_errors, strict=True) if row.any()}
    if np.sum(errors_px(problem)[0] ** 2) < ROUNDING_PX**2 * 2 * len(problem.views[0].used):
        return ()
    strain, free_names = 0.0, {*names, *uncertain}
    if uncertain:
        problem, strain = fit_under_prior(problem, names, lens_errors)
    score = score_of_points(with_lens_parameters_free(problem, free_names))
    groups = {
        tuple(all_names[row] for row in rows): rows
        for parameters in _groups(problem.state.lenses)
        if (rows := [all_names.index(name) for name in parameters if name not in free_names])
    }
    if model is PoseModel.AIMED:
        first = problem.slices.camera(0).start + model.size
        groups[_AIM] = [first, first + 1]
    notes, group = [], score.strongest(groups)
    if group is not None:
        test = score.test(groups[group])
        if is_refuted(score.p_value(test), len(groups), problem.tuning.answer.chance):
            test = test.with_noise(score.noise_variance(test))
            notes.append(_sentence_on_points(problem, group, groups[group], test))
    if strain > problem.tuning.answer.strain_sigmas:
        sentence = sentences.lens_strained(strain)
        notes.append(sentence[0].upper() + sentence[1:])
    return tuple(notes)


def _groups(lens: AbstractLens) -> Iterator[tuple[str, ...]]:
    """Yield the names of the lens parameters that are tested together, group by group."""
    yield from (AFFINE_PARAMETERS[:2], AFFINE_PARAMETERS[2:])
    if SKEW in lens.parameter_names:
        yield (SKEW,)
    for low, high in pairwise(lens.coefficient_counts):
        group = lens.coefficient_names[low:high]
        fitted = tuple(name for name in group if name not in lens.never_fitted)
        if fitted:
            yield fitted


def _sentence_on_points(
    problem: Problem, group: tuple[str, ...], columns: Sequence[int], test: RaoTest
) -> str:
    """Return the warning that the points contradict one group of fixed parameters, with its offset.

    group : names of the parameters, or `_AIM`. columns : their indices among the lens parameters.
    test : score test of the group, scaled to the noise.
    """
    if group is _AIM:
        unit = float(problem.parametrization.unit_mm)
        offset, sigma = unit * test.step, unit * np.sqrt(np.diag(test.covariance))
        return sentences.aim_misses_origin(offset, sigma)
    scale = np.asarray(problem.parametrization.lens_scale)[0][columns]
    return sentences.points_refute_lens(group, *_offset_and_sigma(scale, test))


def _offset_and_sigma(
    scale: Float[np.ndarray, "k"], test: RaoTest
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Predicted change of k fixed parameters if they were estimated, (k,), and its sigmas, (k,).

    Both are in the units of the parameters.

    scale : change of each parameter for a unit change of its local coordinate.
    """
    return scale * test.step, scale * np.sqrt(np.diag(test.covariance))


class _Noise(NamedTuple):
    """Estimated noise variance of the observations.

    Attributes
    ----------
    variance : noise variance, in squared sigmas of the board points.
    freedom : degrees of freedom of this estimate.
    """

    variance: float
    freedom: float

    @classmethod
    def of(cls, score: FixedScore, scatter: ShotScatter) -> "_Noise":
        """Variance of the residuals, or the variance estimated from the scatter between the shots
        if that is larger.

        Errors that the points of a shot have in common do not appear in the residuals, but change
        the lens.
        """
        if score.are_exact:
            # Rounding errors have no variance that tests could divide by.
            return cls(1.0, score.freedom)
        variance = score.squared / max(score.freedom, 1)
        shot_variance = scatter._replace(factor=scatter.factor / variance).variance_factor
        if shot_variance > 1.0:
            return cls(variance * shot_variance, 2.0 / scatter.sigma**2)
        return cls(variance, score.freedom)


def _free_significant_groups(
    score: FixedScore, groups: Mapping[ParameterGroup, list[int]], limit: float
) -> tuple[tuple[ParameterGroup, ...], FixedScore]:
    """Find all groups of fixed parameters that are significant, by forward selection.

    Returns the groups in order, and the normal equations with these groups estimated, to first
    order.

    groups : columns of `score` for each group. limit : significance level of all tests together.
    """
    significant: list[ParameterGroup] = []
    while group := score.strongest(
        {candidate: groups[candidate] for candidate in groups if candidate not in significant}
    ):
        if not is_refuted(score.p_value(score.test(groups[group])), len(groups), limit):
            break
        score = score.with_freed(groups[group])
        significant.append(group)
    return tuple(significant), score


class ExactLensTests(NamedTuple):
    """Score tests of the lenses that a fit to many shots assumed exact.

    Attributes
    ----------
    problem : the problem at its solution, with the parameters of these lenses marked as free.
    information : information of the shots about its free parameters.
    is_tested : (f,) whether each of `information.free` was fixed in the fit.
    score : normal equations of these fixed parameters.
    columns : for each group of lens parameters, their indices in `score`. A group is (index of the
        lens, names of the parameters).
    significant : groups that the observations contradict, in order. Each was tested with the
        earlier ones estimated.
    noise : noise variance with these groups estimated.
    cameras : names of the cameras.
    """

    problem: Problem
    information: Information
    is_tested: Bool[np.ndarray, "f"]
    score: FixedScore
    columns: dict[ParameterGroup, list[int]]
    significant: tuple[ParameterGroup, ...]
    noise: _Noise
    cameras: tuple[str, ...]

    @classmethod
    def of(cls, fit: RobustFit, cameras: Sequence[str]) -> "ExactLensTests | None":
        """Compute the tests from a fit; None if no lens was assumed exact. cameras : names of the
        cameras.
        """
        problem, is_exact = fit.problem, np.logical_not(free_of_lenses(fit.problem).any(axis=1))
        if not is_exact.any():
            return None
        freed_problem = _with_free_lenses(problem, is_exact)
        information, (count, size) = (
            compute_information(freed_problem),
            freed_problem.parametrization.lens_shape,
        )
        lens_index, row = np.divmod(information.free, size)
        is_tested = np.isin(lens_index, np.flatnonzero(is_exact)) & (lens_index < count)
        errors = np.concatenate(
            [error[view.rows_used] for view, error in zip(problem.views, errors_px(problem))]
        )
        are_exact = bool(np.sum(errors**2) < ROUNDING_PX**2 * errors.size)
        remaining, gradient, total_information = score_of_fixed(information, is_tested)
        lens = freed_problem.state.lenses
        names = [lens.parameter_names[column] for column in row[is_tested]]
        column_of = {
            parameter: column
            for column, parameter in enumerate(zip(lens_index[is_tested].tolist(), names))
        }
        score = FixedScore(
            remaining, gradient, total_information, fit.chi_square, fit.freedom, are_exact
        )
        columns = {
            (k, group): [column_of[k, name] for name in group]
            for k in np.flatnonzero(is_exact).tolist()
            for group in _groups(lens)
        }
        significant, freed_score = _free_significant_groups(
            score, columns, problem.tuning.answer.chance
        )
        is_freed = ~is_tested
        is_freed[
            np.flatnonzero(is_tested)[
                [column for group in significant for column in columns[group]]
            ]
        ] = True
        scatter = shot_scatter(information.restrict_to(is_freed), is_tested[is_freed])
        return cls(
            problem=freed_problem,
            information=information,
            is_tested=is_tested,
            score=score,
            columns=columns,
            significant=significant,
            noise=_Noise.of(freed_score, scatter),
            cameras=tuple(cameras),
        )

    def describe_refuted_lens(self) -> str | None:
        """Return the warning that the shots contradict a lens, with the predicted offsets, or None.

        Only the most significant group of parameters is named, since its error also changes other
        lenses.
        """
        if not self.significant:
            return None
        group = lens_index, parameters = self.significant[0]
        test = self.score.test(self.columns[group])
        if not is_refuted(
            test.p_value_with_noise(*self.noise),
            len(self.columns),
            self.problem.tuning.answer.chance,
        ):
            return None
        test = test.with_noise(self.noise.variance)
        owners = _cameras_of_lens(self.problem, self.cameras, lens_index)
        offsets, sigmas = _offset_and_sigma(self._scale(group), test)
        return sentences.shots_refute_lens(owners, parameters, offsets, sigmas)

    def describe_undetectable_error(self, covariance: Float[np.ndarray, "g g"]) -> str | None:
        """Return the warning about the lens error that the shots cannot show and that would move a
        camera most.

        None if every undetectable error would move every camera by only a few of its sigmas.
        (Baarda's external reliability.)

        covariance : (g, g) reported covariance of the g estimated parameters.
        """
        fitted, cameras = self.information.restrict_to(~self.is_tested), self.problem.slices.cameras
        tested = self.information.free[self.is_tested]
        is_pose = (fitted.free >= cameras.start) & (fitted.free < cameras.stop)
        pose_covariance = -np.nan_to_num(fitted.observability.covariance)[is_pose]
        motion_by_error = (
            pose_covariance
            @ self.information.shot_information.sum(axis=0)[np.ix_(fitted.free, tested)]
        )
        in_sigmas = motion_by_error / np.sqrt(np.diag(covariance)[is_pose])[:, None]
        tuning = self.problem.tuning.answer
        worst, sentence = tuning.strain_sigmas, None
        for group, columns in self.columns.items():
            test, (lens_index, parameters) = self.score.test(columns), group
            if parameters[0] not in AFFINE_PARAMETERS or test.freedom < len(parameters):
                continue
            root = np.linalg.cholesky(test.with_noise(self.noise.variance).covariance)
            chance = tuning.chance / len(self.columns)
            error = root * detectable_sigmas(chance, test.freedom, tuning.power)
            motion = in_sigmas[:, columns] @ error
            strain = np.linalg.norm(motion, axis=1)
            row = int(np.argmax(strain))
            if not strain[row] > worst:
                continue
            worst = float(strain[row])
            offsets = self._scale(group) * (error @ motion[row]) / worst
            camera = self.cameras[(fitted.free[is_pose][row] - cameras.start) // POSE_SIZE]
            owners = _cameras_of_lens(self.problem, self.cameras, lens_index)
            sentence = sentences.lens_error_undetectable(owners, parameters, offsets, camera, worst)
        return sentence

    def _scale(self, group: ParameterGroup) -> Float[np.ndarray, "k"]:
        """Change of each of k lens parameters for a unit change of its local coordinate, (k,).

        group : (index of the lens, names of the k parameters).
        """
        lens_index, parameters = group
        names = self.problem.state.lenses.parameter_names
        return np.asarray(self.problem.parametrization.lens_scale)[
            lens_index, [names.index(n) for n in parameters]
        ]


def describe_strained_lens(problem: Problem, cameras: Sequence[str]) -> str | None:
    """Return the warning about the given lens that the shots contradict most; None if they
    contradict none.

    Only lenses with a prior covariance are tested. The test statistic is the largest difference
    between fitted and given lens along a principal axis of the prior, in sigmas.

    cameras : names of the cameras.
    """
    worst, sentence, priors = problem.tuning.answer.strain_sigmas, None, problem.priors
    for lens_index in np.flatnonzero(has_lens_prior(problem.priors)).tolist():
        scale = np.asarray(problem.parametrization.lens_scale)[lens_index]
        lens = lens_of_index(problem, lens_index)
        offset = np.asarray(lens.parameters) - priors.lens_mean[lens_index]
        information = priors.lens_information[lens_index] * np.outer(scale, scale)
        values, axes = np.linalg.eigh(information)
        strain = float(np.abs(np.sqrt(np.maximum(values, 0.0)) * (axes.T @ (offset / scale))).max())
        if strain > worst:
            worst = strain
            owners = _cameras_of_lens(problem, cameras, lens_index)
            sentence = sentences.lens_of_cameras_strained(owners, strain)
    return sentence


def _cameras_of_lens(problem: Problem, cameras: Sequence[str], lens_index: int) -> list[str]:
    """Names of the cameras that use the lens with index `lens_index`."""
    lens_of_camera = np.asarray(problem.parametrization.lens_of_camera)
    return [name for name, lens in zip(cameras, lens_of_camera) if lens == lens_index]


def _with_free_lenses(problem: Problem, freed: Bool[np.ndarray, "l"]) -> Problem:
    """Problem in which all parameters of some lenses are free, in a more general lens model.

    freed : (l,) mask of these lenses. The free parameters of the other lenses do not change.
    """
    free, sizes = free_of_lenses(problem), problem.image_sizes_px
    first = [int(np.argmax(problem.parametrization.lens_of_camera == k)) for k in range(len(freed))]
    lenses = [skew_lens(lens_of_index(problem, k)) for k in range(len(freed))]
    wider = with_wider_lenses(problem, lenses, [sizes[camera] for camera in first])
    names, never_fitted = lenses[0].parameter_names, lenses[0].never_fitted
    free = np.pad(free, ((0, 0), (0, len(names) - free.shape[1])))
    free[freed] = [name not in never_fitted for name in names]
    all_free = np.array(wider.free)
    all_free[: free.size] = free.ravel()
    return with_free_parameters(wider, all_free)
