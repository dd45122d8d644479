"""The fit of an ideal camera: robust steps, a gate for pixels, steps of least squares."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.appearance import NUISANCE
from trinoc.calib.photometric.gate import Gate, gate_pixels
from trinoc.calib.photometric.gauss_newton import (
    Fit,
    Group,
    ImageState,
    Stage,
    StagedGaussNewton,
    run_fit,
)
from trinoc.calib.photometric.image_problem import ImageProblem
from trinoc.calib.photometric.patches import PixelRows, homography_of_pose
from trinoc.calib.photometric.pixel_selection import PARTS
from trinoc.geometry import PoseModel
from trinoc.numerics import GemanMcClure, one_compiles

# Shares of the contrast at which a residual loses its influence while the fit finds its way.
_SCALES = (0.12, 0.07, 0.05)
# The first steps need not be exact: they look at a part of the pixels.
_STRIDES = (PARTS, PARTS, 1)
# The fit has converged when a step is this share of its own standard deviation, looked at after
# every second step: what is left then is the square of it. Pixels in single precision leave steps
# of .1 in a picture of 16 megapixels.
_PLAIN_STEPS = 2
_CONVERGED_SIGMAS = 0.3


class IdealFit(NamedTuple):
    """Where the fit of an ideal camera ended.

    Fields
    ------
    problem : its pixels.
    robust : where the robust steps ended.
    gate : what was cut there.
    groups : the pixels as they were weighed in the last steps.
    last : where these ended.
    """

    problem: ImageProblem
    robust: Fit
    gate: Gate
    groups: tuple[Group, Group]
    last: Fit

    @property
    def kept(self) -> Bool[np.ndarray, "n"]:
        """The pixels that stayed."""
        return self.gate.kept

    @property
    def freedom(self) -> int:
        """Pixels that stayed, less unknowns."""
        return int(self.kept.sum()) - self.problem.model.size - NUISANCE

    @property
    def state(self) -> ImageState:
        """Pose and appearance."""
        return jax.tree.map(np.asarray, self.last.state)

    @property
    def converged(self) -> bool:
        """Whether the last step was short."""
        return bool(self.last.converged)

    @property
    def residuals(self) -> Float[np.ndarray, "n"]:
        """Predicted less observed, grey levels, before the last step."""
        return _residuals(self.last, self.problem)

    @property
    def noise(self) -> float:
        """Standard deviation of the residuals, as they were weighed."""
        counts = self.problem.counts
        weights = np.concatenate(
            [group.pixels.weight[:n] for group, n in zip(self.groups, counts, strict=True)]
        )
        squares = weights[self.kept] * self.residuals[self.kept].astype(np.float64) ** 2
        return float(np.sqrt(np.sum(squares) / self.freedom))

    @property
    def pose_information(self) -> Float[np.ndarray, "p p"]:
        """Information of the pose alone, for noise of one grey level."""
        return _marginal(np.asarray(self.last.sums.information), self.problem.model.size)

    def reweighted(self, share: Float[np.ndarray, "n"]) -> "IdealFit":
        """Fitted again with the weight of each pixel times `share`."""
        near_circles, near_lines = np.split(share, [self.problem.counts[0]])
        groups = (_weighed(self.groups[0], near_circles), _weighed(self.groups[1], near_lines))
        return self._replace(
            groups=groups, last=_plain_fit(self.last.state, groups, self.problem, self.gate)
        )


def fit_ideal_camera(problem: ImageProblem) -> IdealFit | None:
    """The fit of an ideal camera; None where too few pixels stay."""
    model, contrast = problem.model, problem.contrast
    state = ImageState(problem.start, problem.appearance)
    robust = _run(state, problem.groups, problem, _robust(contrast, model))
    gate = gate_pixels(problem.everything, _residuals(robust, problem), contrast)
    near_circles, near_lines = np.split(gate.kept, [problem.counts[0]])
    groups = (
        _weighed(problem.groups[0], near_circles),
        _weighed(problem.groups[1], near_lines),
    )
    last = _plain_fit(robust.state, groups, problem, gate)
    fit = IdealFit(problem, robust, gate, groups, last)
    return fit if fit.freedom > 0 else None


def rows_of_ideal(fit: IdealFit) -> tuple[Float[np.ndarray, "3 3"], PixelRows]:
    """The pixels that stayed, at the end of the fit, and the homography there."""
    groups, chosen, sums = fit.groups, fit.problem.chosen, fit.last.sums
    kept = [np.flatnonzero(group.pixels.weight) for group in groups]
    both = list(zip(groups, kept, sums.columns, sums.residuals, strict=True))
    columns = np.concatenate([np.asarray(part)[:, own] for _, own, part, _ in both], axis=1)
    rays = [jax.tree.map(lambda leaf, own=own: leaf[own], g.pixels.ray) for g, own, _, _ in both]
    near_lines = np.full(len(kept[1]), -1)
    rows = PixelRows(
        np.concatenate([chosen[0].circle[kept[0]], near_lines]),
        jax.tree.map(lambda *leaves: np.concatenate(leaves), *rays),
        columns[:3],
        columns[3:],
        np.concatenate([np.asarray(part)[own] for _, own, _, part in both]),
        np.concatenate([group.pixels.weight[own] for group, own, _, _ in both]) / fit.noise**2,
        np.zeros(NUISANCE),
        np.zeros(NUISANCE),
    )
    # The pixels were looked at through what single precision leaves of the homography.
    return np.asarray(homography_of_pose(sums.pose)).astype(np.float32).astype(np.float64), rows


def _residuals(fit: Fit, problem: ImageProblem) -> Float[np.ndarray, "n"]:
    both = zip(fit.sums.residuals, problem.counts, strict=True)
    return np.concatenate([np.asarray(part)[:count] for part, count in both])


def _plain_fit(
    start: ImageState, groups: tuple[Group, Group], problem: ImageProblem, gate: Gate
) -> Fit:
    return _run(start, groups, problem, _plain(gate.sigma, problem.model))


def _run(
    start: ImageState,
    groups: tuple[Group, Group],
    problem: ImageProblem,
    solver: StagedGaussNewton,
) -> Fit:
    drawing, model = problem.drawing, problem.model
    with one_compiles("run_fit", drawing, model, groups[0].pixels.grey.shape):
        return run_fit(start, *groups, problem.cross, solver, drawing=drawing, model=model)


def _robust(contrast: float, model: PoseModel) -> StagedGaussNewton:
    """One step at each scale.

    Ink spread and the slopes of the light wait for the pose: they would bend to swallow
    what covers the sheet.
    """
    spread, first_slope = model.size + 1, model.size + 4
    held = np.zeros((len(_SCALES), model.size + NUISANCE))
    held[:2, spread] = 1.0
    held[0, first_slope:] = 1.0
    held[1, first_slope + 2 :] = 1.0
    loss = GemanMcClure.from_scale(contrast * np.array(_SCALES))
    stages = Stage(loss, held, np.array(_STRIDES, dtype=np.int32))
    return StagedGaussNewton(
        stages=stages,
        round_steps=np.asarray(len(_SCALES)),
        model=model,
        atol=np.asarray(np.inf),
    )


def _plain(sigma: float, model: PoseModel) -> StagedGaussNewton:
    """Steps of least squares over all pixels, in arrays of the robust steps' shapes."""
    count = len(_SCALES)
    held = np.zeros((count, model.size + NUISANCE))
    loss = GemanMcClure.from_scale(np.full(count, np.inf))
    stages = Stage(loss, held, np.ones(count, dtype=np.int32))
    return StagedGaussNewton(
        stages=stages,
        round_steps=np.asarray(_PLAIN_STEPS),
        model=model,
        atol=np.asarray(_CONVERGED_SIGMAS * sigma),
    )


def _weighed(group: Group, share: np.ndarray) -> Group:
    weight = np.array(group.pixels.weight)
    weight[: len(share)] *= share
    return group._replace(pixels=group.pixels._replace(weight=weight))


def _marginal(information: Float[np.ndarray, "k k"], pose_size: int) -> Float[np.ndarray, "p p"]:
    """Information of the pose alone: the Schur complement of the appearance."""
    pose, look = information[:pose_size], information[pose_size:]
    across = pose[:, pose_size:]
    inner = look[:, pose_size:]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner / (scale[:, None] * scale)
    if not np.isfinite(scaled).all():
        return np.full((pose_size, pose_size), np.nan)
    try:
        follow = np.linalg.solve(scaled, (across / scale).T)
    except np.linalg.LinAlgError:
        return np.full((pose_size, pose_size), np.nan)
    return pose[:, :pose_size] - (across / scale) @ follow
