"""Tests of fixed lenses and aims that points or shots may contradict."""

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
    lens_number,
    with_free_head,
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
    """Sentences on fixed parameters of lens or aim that the points contradict; empty without one.

    Parameters
    ----------
    problem : the fit with the parameters `names` free.
    lens_errors : change of the lens's parameters for one sigma of each error that is not fitted;
        parameters without any are exact.
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
    """Groups of a lens's parameters that are tested together."""
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
    """Sentence on the group that explains most of the residuals, with its offset.

    test : score test of the group, with the noise's covariance.
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
    """Estimated offsets of fixed parameters, and their sigmas. scale : change for a unit step."""
    return scale * test.step, scale * np.sqrt(np.diag(test.covariance))


class _Noise(NamedTuple):
    """Noise of the observations.

    variance : in squared sigmas of the board points. freedom : degrees of freedom of its estimate.
    """

    variance: float
    freedom: float

    @classmethod
    def of(cls, score: FixedScore, scatter: ShotScatter) -> "_Noise":
        """Noise of the observations; that of the shots if larger, since it biases lenses."""
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
    """Groups that are significant one after the other, and the score with these freed."""
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
    """Score tests of lenses that were assumed exact, from the shots.

    Attributes
    ----------
    problem : the problem at its solution, with these lenses free.
    information : information of its shots.
    is_tested : (f,) whether each of `information.free` was fixed in the fit.
    score : score of the fixed parameters, in their order.
    columns : columns of the score for each lens (by its number) and group of its parameters.
    significant : groups that the observations contradict, each with those before it freed.
    noise : noise with these groups freed.
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
        """Tests of the lenses that were assumed exact; None without one. cameras : their names."""
        problem, is_exact = fit.problem, np.logical_not(free_of_lenses(fit.problem).any(axis=1))
        if not is_exact.any():
            return None
        freed_problem = _with_free_lenses(problem, is_exact)
        information, (count, size) = (
            compute_information(freed_problem),
            freed_problem.parametrization.lens_shape,
        )
        number, row = np.divmod(information.free, size)
        is_tested = np.isin(number, np.flatnonzero(is_exact)) & (number < count)
        errors = np.concatenate(
            [error[view.rows_used] for view, error in zip(problem.views, errors_px(problem))]
        )
        are_exact = bool(np.sum(errors**2) < ROUNDING_PX**2 * errors.size)
        remaining, gradient, total_information = score_of_fixed(information, is_tested)
        lens = freed_problem.state.lenses
        names = [lens.parameter_names[column] for column in row[is_tested]]
        column_of = {
            parameter: column
            for column, parameter in enumerate(zip(number[is_tested].tolist(), names))
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
        """Sentence on the lens that the shots contradict, with the offsets; None without one.

        Only the most significant group is named, since its error also appears in other lenses.
        """
        if not self.significant:
            return None
        group = number, parameters = self.significant[0]
        test = self.score.test(self.columns[group])
        if not is_refuted(
            test.p_value_with_noise(*self.noise),
            len(self.columns),
            self.problem.tuning.answer.chance,
        ):
            return None
        test = test.with_noise(self.noise.variance)
        owners = _cameras_of_lens(self.problem, self.cameras, number)
        offsets, sigmas = _offset_and_sigma(self._scale(group), test)
        return sentences.shots_refute_lens(owners, parameters, offsets, sigmas)

    def describe_undetectable_error(self, covariance: Float[np.ndarray, "g g"]) -> str | None:
        """Sentence on the undetectable lens error that would move a camera most; None if it is
        small.

        covariance : reported covariance of the fitted parameters.

        This is Baarda's external reliability; `adjustment.model_tests` does the same for one image.
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
            test, (number, parameters) = self.score.test(columns), group
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
            owners = _cameras_of_lens(self.problem, self.cameras, number)
            sentence = sentences.lens_error_undetectable(owners, parameters, offsets, camera, worst)
        return sentence

    def _scale(self, group: ParameterGroup) -> Float[np.ndarray, "k"]:
        """Change of each parameter of a group for a unit step."""
        number, parameters = group
        names = self.problem.state.lenses.parameter_names
        return np.asarray(self.problem.parametrization.lens_scale)[
            number, [names.index(n) for n in parameters]
        ]


def describe_strained_lens(problem: Problem, cameras: Sequence[str]) -> str | None:
    """Sentence on the given lens that the shots contradict most; None if they contradict none.

    Only lenses with a covariance are tested. The strain is the largest step from the prior mean
    along a principal axis, in its sigmas.
    """
    worst, sentence, priors = problem.tuning.answer.strain_sigmas, None, problem.priors
    for number in np.flatnonzero(has_lens_prior(problem.priors)).tolist():
        scale = np.asarray(problem.parametrization.lens_scale)[number]
        lens = lens_number(problem, number)
        offset = np.asarray(lens.parameters) - priors.lens_mean[number]
        information = priors.lens_information[number] * np.outer(scale, scale)
        values, axes = np.linalg.eigh(information)
        strain = float(np.abs(np.sqrt(np.maximum(values, 0.0)) * (axes.T @ (offset / scale))).max())
        if strain > worst:
            worst = strain
            owners = _cameras_of_lens(problem, cameras, number)
            sentence = sentences.lens_of_cameras_strained(owners, strain)
    return sentence


def _cameras_of_lens(problem: Problem, cameras: Sequence[str], number: int) -> list[str]:
    """Names of the cameras that have a lens."""
    lens_of_camera = np.asarray(problem.parametrization.lens_of_camera)
    return [name for name, lens in zip(cameras, lens_of_camera) if lens == number]


def _with_free_lenses(problem: Problem, freed: Bool[np.ndarray, "l"]) -> Problem:
    """Problem with all parameters of some lenses free, in the widest model that contains theirs.

    freed : (l,) mask of the lenses to free. The other lenses keep their free parameters.
    """
    free, sizes = free_of_lenses(problem), problem.image_sizes_px
    first = [int(np.argmax(problem.parametrization.lens_of_camera == k)) for k in range(len(freed))]
    lenses = [skew_lens(lens_number(problem, k)) for k in range(len(freed))]
    wider = with_wider_lenses(problem, lenses, [sizes[camera] for camera in first])
    names, never_fitted = lenses[0].parameter_names, lenses[0].never_fitted
    free = np.pad(free, ((0, 0), (0, len(names) - free.shape[1])))
    free[freed] = [name not in never_fitted for name in names]
    head = np.array(wider.free)
    head[: free.size] = free.ravel()
    return with_free_head(wider, head)
