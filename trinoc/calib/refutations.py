"""Tests of what was assumed of cameras: held lenses and aims that points or shots contradict."""

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
    is_given,
    lens_number,
    with_head_free,
    with_wider_lenses,
)
from trinoc.calib.problem.rao_test import (
    HeldScore,
    RaoTest,
    explain_pull,
    is_refuted,
    unseen_sigmas,
)
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.variables import POSE_SIZE
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.skewed import SKEW, skew_lens
from trinoc.geometry.pose import PoseModel

_AIM = ("aim",)
# Of a rig: the number of a lens, and names of its parameters that are fitted together.
Cause = tuple[int, tuple[str, ...]]


def refutations_of_points(
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
        problem, strain = fit_under_prior(problem, names, held)
    score = score_of_points(with_lens_parameters_free(problem, open_))
    causes = {
        tuple(every[row] for row in rows): rows
        for group in _groups(problem.state.lenses)
        if (rows := [every.index(name) for name in group if name not in open_])
    }
    if model is PoseModel.AIMED:
        first = problem.slices.camera(0).start + model.size
        causes[_AIM] = [first, first + 1]
    notes, cause = [], score.strongest(causes)
    if cause is not None:
        test = score.judge(causes[cause])
        if is_refuted(score.chance(test), len(causes), problem.tuning.answer.chance):
            test = test.with_noise(score.noise_variance(test))
            notes.append(_sentence_on_points(problem, cause, causes[cause], test))
    if strain > problem.tuning.answer.strain_sigmas:
        sentence = sentences.lens_strained(strain)
        notes.append(sentence[0].upper() + sentence[1:])
    return tuple(notes)


def _groups(lens: AbstractLens) -> Iterator[tuple[str, ...]]:
    """Yield the groups of a lens's parameters that are tested together."""
    yield from (AFFINE_PARAMETERS[:2], AFFINE_PARAMETERS[2:])
    if SKEW in lens.parameter_names:
        yield (SKEW,)
    for low, high in pairwise(lens.coefficient_counts):
        group = lens.coefficient_names[low:high]
        fitted = tuple(name for name in group if name not in lens.never_fitted)
        if fitted:
            yield fitted


def _sentence_on_points(
    problem: Problem, cause: tuple[str, ...], columns: Sequence[int], test: RaoTest
) -> str:
    """What explains most of the residuals, and by how much it is off. test : of the cause, with
    the noise's covariance."""
    if cause is _AIM:
        unit = float(problem.parametrization.unit_mm)
        off, sigma = unit * test.step, unit * np.sqrt(np.diag(test.covariance))
        return sentences.aim_misses_origin(off, sigma)
    scale = np.asarray(problem.parametrization.lens_scale)[0][columns]
    return sentences.points_refute_lens(cause, *_offset_and_sigma(scale, test))


def _offset_and_sigma(
    scale: Float[np.ndarray, "k"], test: RaoTest
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Estimated offsets of parameters that were held, and sigmas. scale : of each step."""
    return scale * test.step, scale * np.sqrt(np.diag(test.covariance))


class _Noise(NamedTuple):
    """variance : in squared sigmas of the places. freedom : with which it is known."""

    variance: float
    freedom: float

    @classmethod
    def of(cls, score: HeldScore, scatter: ShotScatter) -> "_Noise":
        """Noise of the observations; of the shots if these scatter more, as that biases lenses."""
        variance = score.squared / max(score.freedom, 1)
        of_shots = scatter._replace(factor=scatter.factor / variance).variance_factor
        if of_shots > 1.0:
            return cls(variance * of_shots, 2.0 / scatter.sigma**2)
        return cls(variance, score.freedom)


def _free_causes(
    score: HeldScore, causes: Mapping[Cause, list[int]], limit: float
) -> tuple[tuple[Cause, ...], HeldScore]:
    """Causes that are refuted in turn, the strongest first, and the score once they are free."""
    freed: list[Cause] = []
    while cause := score.strongest({key: causes[key] for key in causes if key not in freed}):
        if not is_refuted(score.chance(score.judge(causes[cause])), len(causes), limit):
            break
        score = score.with_freed(causes[cause])
        freed.append(cause)
    return tuple(freed), score


class HeldLenses(NamedTuple):
    """What shots say of lenses that were held as a whole.

    Fields
    ------
    problem : at the end of the fit, with these lenses open.
    information : of its shots.
    is_asked : (f,) which of `information.free` were held.
    score : of these, in their order.
    causes : columns of the score for each lens, by its number, and each group of its parameters.
    freed : causes that the places ask for, each beside those before it.
    noise : what is left with these free.
    cameras : their names.
    """

    problem: Problem
    information: Information
    is_asked: Bool[np.ndarray, "f"]
    score: HeldScore
    causes: dict[Cause, list[int]]
    freed: tuple[Cause, ...]
    noise: _Noise
    cameras: tuple[str, ...]

    @classmethod
    def of(cls, fit: RobustFit, cameras: Sequence[str]) -> "HeldLenses | None":
        """None where no lens was held as a whole. cameras : their names."""
        problem, is_held = fit.problem, np.logical_not(free_of_lenses(fit.problem).any(axis=1))
        if not is_held.any():
            return None
        opened = _with_lenses_open(problem, is_held)
        information, (count, size) = compute_information(opened), opened.parametrization.lens_shape
        number, row = np.divmod(information.free, size)
        is_asked = np.isin(number, np.flatnonzero(is_held)) & (number < count)
        errors = np.concatenate([e[v.kept] for v, e in zip(problem.views, errors_px(problem))])
        are_exact = bool(np.sum(errors**2) < ROUNDING_PX**2 * errors.size)
        left, pull, whole = explain_pull(information, is_asked)
        lens = opened.state.lenses
        names = [lens.parameter_names[at] for at in row[is_asked]]
        place = {key: at for at, key in enumerate(zip(number[is_asked].tolist(), names))}
        score = HeldScore(left, pull, whole, fit.chi_square, fit.freedom, are_exact)
        causes = {
            (k, group): [place[k, name] for name in group]
            for k in np.flatnonzero(is_held).tolist()
            for group in _groups(lens)
        }
        freed, after = _free_causes(score, causes, problem.tuning.answer.chance)
        is_freed = ~is_asked
        is_freed[np.flatnonzero(is_asked)[[at for one in freed for at in causes[one]]]] = True
        scatter = shot_scatter(information.of_steps(is_freed), is_asked[is_freed])
        return cls(
            problem=opened,
            information=information,
            is_asked=is_asked,
            score=score,
            causes=causes,
            freed=freed,
            noise=_Noise.of(after, scatter),
            cameras=tuple(cameras),
        )

    def say_what_is_refuted(self) -> str | None:
        """Sentence on the lens that the shots contradict, and by how much; None without one.

        Only the strongest cause is named, since its error also shows in other lenses.
        """
        if not self.freed:
            return None
        cause = number, group = self.freed[0]
        test = self.score.judge(self.causes[cause])
        if not is_refuted(
            test.chance_by(*self.noise), len(self.causes), self.problem.tuning.answer.chance
        ):
            return None
        test = test.with_noise(self.noise.variance)
        owners = _cameras_of_lens(self.problem, self.cameras, number)
        offsets, sigmas = _offset_and_sigma(self._scale(cause), test)
        return sentences.shots_refute_lens(owners, group, offsets, sigmas)

    def say_what_goes_unseen(self, covariance: Float[np.ndarray, "g g"]) -> str | None:
        """Sentence on the undetectable lens error that would move a camera most; None if small.

        covariance : that reported for the fitted parameters.

        This is Baarda's external reliability, as `adjustment.model_tests` has it of one picture.
        """
        of_fit, cameras = self.information.of_steps(~self.is_asked), self.problem.slices.cameras
        asked = self.information.free[self.is_asked]
        of_pose = (of_fit.free >= cameras.start) & (of_fit.free < cameras.stop)
        by_fitted = -np.nan_to_num(of_fit.observability.covariance)[of_pose]
        by_asked = by_fitted @ self.information.of_shot.sum(axis=0)[np.ix_(of_fit.free, asked)]
        in_sigmas = by_asked / np.sqrt(np.diag(covariance)[of_pose])[:, None]
        tuning = self.problem.tuning.answer
        worst, sentence = tuning.strain_sigmas, None
        for cause, columns in self.causes.items():
            test, (number, group) = self.score.judge(columns), cause
            if group[0] not in AFFINE_PARAMETERS or test.freedom < len(group):
                continue
            root = np.linalg.cholesky(test.with_noise(self.noise.variance).covariance)
            chance = tuning.chance / len(self.causes)
            error = root * unseen_sigmas(chance, test.freedom, tuning.power)
            moved = in_sigmas[:, columns] @ error
            strain = np.linalg.norm(moved, axis=1)
            row = int(np.argmax(strain))
            if not strain[row] > worst:
                continue
            worst = float(strain[row])
            offsets = self._scale(cause) * (error @ moved[row]) / worst
            camera = self.cameras[(of_fit.free[of_pose][row] - cameras.start) // POSE_SIZE]
            owners = _cameras_of_lens(self.problem, self.cameras, number)
            sentence = sentences.lens_error_unseen(owners, group, offsets, camera, worst)
        return sentence

    def _scale(self, cause: Cause) -> Float[np.ndarray, "k"]:
        """Change of each parameter of a cause for a step of one."""
        number, group = cause
        every = self.problem.state.lenses.parameter_names
        return np.asarray(self.problem.parametrization.lens_scale)[
            number, [every.index(n) for n in group]
        ]


def say_strained_lens(problem: Problem, cameras: Sequence[str]) -> str | None:
    """Sentence on the given lens that the shots contradict most; None if they contradict none.

    Tested are lenses that were given with a covariance. The strain is the largest step from the
    prior's mean along a principal axis, in its sigmas.
    """
    worst, sentence, priors = problem.tuning.answer.strain_sigmas, None, problem.priors
    for number in np.flatnonzero(is_given(problem.priors)).tolist():
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
    """Names of the cameras that have a lens, by its number."""
    lens_of_camera = np.asarray(problem.parametrization.lens_of_camera)
    return [name for name, lens in zip(cameras, lens_of_camera) if lens == number]


def _with_lenses_open(problem: Problem, which: Bool[np.ndarray, "l"]) -> Problem:
    """The problem with all parameters of some lenses free, in the widest model that has theirs.

    which : of each lens, whether it is freed. The other lenses keep what is free of them.
    """
    free, sizes = free_of_lenses(problem), problem.image_sizes_px
    first = [int(np.argmax(problem.parametrization.lens_of_camera == k)) for k in range(len(which))]
    lenses = [skew_lens(lens_number(problem, k)) for k in range(len(which))]
    wider = with_wider_lenses(problem, lenses, [sizes[camera] for camera in first])
    names, never = lenses[0].parameter_names, lenses[0].never_fitted
    free = np.pad(free, ((0, 0), (0, len(names) - free.shape[1])))
    free[which] = [name not in never for name in names]
    head = np.array(wider.free)
    head[: free.size] = free.ravel()
    return with_head_free(wider, head)
