"""The cameras over one sheet, adjusted and judged."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.adjustment.least_squares import Adjusted, Unknowns, Views, adjust
from trinoc.calib.adjustment.sheet_shape import shape_sigmas
from trinoc.calib.model import ANNEALING, GATE, SheetPoints, bucket_size, robust_scale
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import AbstractLens, Pose, PoseModel, promoted, stack_lenses
from trinoc.numerics import ArrayLike, as_numpy

# Programs exist for this many cameras, and for its doubles.
_FEWEST_CAMERAS = 3
# Chi-square beyond this many of its own standard deviations is not noise: the sigmas grow.
_CHI_SQUARE_DEVIATIONS = 4.0


class SheetView(NamedTuple):
    """What one camera shows of the sheet, and where it is thought to stand.

    Fields
    ------
    points : places of the sheet in its picture.
    pose : from which the adjustment starts.
    lens : as the user says it.
    lens_factor : (k, r) L of the covariance L L^T of the first k of the lens's parameters; None for
        a lens that is exact.
    has_outliers : whether places of `points` may be wrong one by one.
    """

    points: SheetPoints
    pose: Pose
    lens: AbstractLens
    lens_factor: Float[np.ndarray, "_k _r"] | None
    has_outliers: bool


class Adjustment(NamedTuple):
    """What the cameras' pictures and all priors say together.

    Fields
    ------
    parameters : (v, p) pan, tilt, swing in rad, distance and, where it is free, the aim in mm.
    jacobian : (v, 2n, k) of whitened residuals by all unknowns: the steps of the poses one after
        the other, lengths in units of each distance, then lenses and sheet in standard deviations
        of their priors.
    root : (k, k) upper triangular R, of their information R^T R, the priors included. Pixels of
        one picture and a prior on its lens differ by so much in weight that the information itself
        would not hold both.
    covariance : (k, k) of them.
    adjusted : see `Adjusted`; its cameras beyond the first v are padding.
    reach_mm : () distance from the origin at which the sheet's heights count.
    lens_index : (v,) which lens of `adjusted.unknowns` each camera has.
    used : for each camera, (n,) places that took part.
    reduced_chi_square : (v,) of the places, before sigmas were enlarged by it.
    freedom : (v,) degrees of freedom of the same.
    enlarged : (v,) by how much they were; 1 where the places scatter as they claim.
    converged : whether the last adjustment has.
    """

    parameters: Float[np.ndarray, "v p"]
    jacobian: Float[np.ndarray, "v m k"]
    root: Float[np.ndarray, "k k"]
    covariance: Float[np.ndarray, "k k"]
    adjusted: Adjusted
    reach_mm: Float[ArrayLike, ""]
    lens_index: Int[np.ndarray, "_v"]
    used: list[np.ndarray]
    reduced_chi_square: Float[np.ndarray, "v"]
    freedom: Float[np.ndarray, "v"]
    enlarged: Float[np.ndarray, "v"]
    converged: bool

    def pose_root(self, view: int) -> Float[np.ndarray, "p p"]:
        """R of the information R^T R of one camera's step, all else being as uncertain as it is."""
        rows = self.rows(view)
        others = np.delete(np.arange(len(self.root)), rows)
        last = np.concatenate([others, np.arange(rows.start, rows.stop)])
        return _triangle(self.root[:, last])[len(others) :, len(others) :]

    def lens_row(self, view: int) -> int:
        """The first row of one camera's lens in `covariance`."""
        terms = self.adjusted.unknowns.lens.shape[1]
        return self.parameters.size + int(self.lens_index[view]) * terms

    def rows(self, view: int) -> slice:
        """The rows of one camera's step in `covariance`."""
        size = self.parameters.shape[1]
        return slice(view * size, (view + 1) * size)


def adjusted_views(
    views: Sequence[SheetView],
    systematics: Systematics,
    model: PoseModel,
    aim_sigma_mm: float,
    near: Adjustment | None = None,
) -> Adjustment:
    """All cameras together, places that fit none of it left out.

    near : an adjustment of the same cameras from the same poses, from which this one starts.

    A camera whose places scatter more than they claim gets sigmas that are larger by that much, in
    a second adjustment where it weighs less.
    """
    known = _stacked(views, systematics, aim_sigma_mm)
    count = len(views)
    start = _no_change(known, model) if near is None else near.adjusted.unknowns
    found = as_numpy(adjust(start, known, model=model))
    used = [np.ones(len(view.points.place_mm), dtype=bool) for view in views]
    suspects = [k for k in range(count) if views[k].has_outliers and _worst(found, k) > GATE]
    if suspects:
        known, found = _without_outliers(known, found, used, suspects, model)
    reduced, freedom = _reduced_chi_squares(found, known, count, model)
    largest = 1 + _CHI_SQUARE_DEVIATIONS * np.sqrt(2 / np.maximum(freedom, 1e-9))
    enlarged = np.where(reduced > largest, np.sqrt(reduced), 1.0)
    if (enlarged > 1).any():
        factor = np.concatenate([enlarged, np.ones(len(known.held) - count)])
        whitening = known.points.whitening / factor[:, None, None]
        known = known._replace(points=known.points._replace(whitening=whitening))
        found = as_numpy(adjust(found.unknowns, known, model=model))
    jacobian, prior = _jacobian(found, known, count, model)
    root = _root(jacobian, prior)
    inverse = np.linalg.inv(root)
    parameters = _parameters(found.pose, count, model)
    return Adjustment(
        parameters,
        jacobian,
        root,
        inverse @ inverse.T,
        found,
        known.reach_mm,
        np.asarray(known.lens_index),
        used,
        reduced,
        freedom,
        enlarged,
        bool(found.converged),
    )


def _stacked(
    views: Sequence[SheetView],
    systematics: Systematics,
    aim_sigma_mm: float,
) -> Views:
    """The views along a first axis, padded to a number of cameras that has a program."""
    count = len(views)
    cameras = max(_FEWEST_CAMERAS, 1 << (count - 1).bit_length())
    each = [views[min(k, count - 1)] for k in range(cameras)]
    size = bucket_size(max(len(view.points.place_mm) for view in views))
    points = [view.points.padded(size) for view in each]
    for k in range(count, cameras):
        points[k] = points[k]._replace(whitening=np.zeros_like(points[k].whitening))
    lenses = [promoted(view.lens) for view in each]
    count_of_lens = len(lenses[0].parameter_names)
    # A program for lenses that are all exact, and one for all others.
    terms = 1 if all(view.lens_factor is None for view in each) else count_of_lens
    factors = np.zeros((cameras, count_of_lens, terms))
    for factor, view in zip(factors, each, strict=True):
        if view.lens_factor is not None:
            rows, columns = view.lens_factor.shape
            factor[:rows, :columns] = view.lens_factor
    reach = max(float(np.hypot(*view.points.place_mm.T).max()) for view in views)
    held = (np.arange(cameras) >= count).astype(float)
    return Views(
        pose=jax.tree.map(lambda *leaves: np.stack(leaves), *(view.pose for view in each)),
        lens=stack_lenses(lenses),
        lens_factor=factors,
        lens_index=np.arange(cameras) * (not systematics.lens_is_shared),
        aim_weight=(1 - held) * (1 / aim_sigma_mm if aim_sigma_mm > 0 else 0.0),
        held=held,
        points=jax.tree.map(lambda *leaves: np.stack(leaves), *points),
        outlier_scale=np.full(cameras, np.inf),
        shape_sigma=shape_sigmas(
            systematics.print_size_sigma, systematics.print_scale_sigma, systematics.flatness_mm
        ),
        reach_mm=np.asarray(reach),
    )


def _no_change(views: Views, model: PoseModel) -> Unknowns:
    cameras, _, terms = views.lens_factor.shape
    return Unknowns(
        np.zeros((cameras, model.size)),
        np.zeros((cameras, terms)),
        np.zeros(len(views.shape_sigma)),
    )


def _pairs(found: Adjusted, view: int) -> Float[np.ndarray, "n 2"]:
    return np.asarray(found.whitened[view]).reshape(-1, 2)


def _worst(found: Adjusted, view: int) -> float:
    return float(np.linalg.norm(_pairs(found, view), axis=1).max())


def _without_outliers(
    known: Views, found: Adjusted, used: list[np.ndarray], suspects: list[int], model: PoseModel
) -> tuple[Views, Adjusted]:
    """A robust adjustment names the places that do not fit; one without them is the answer."""
    for share in ANNEALING:
        scale = np.array(known.outlier_scale)
        for k in suspects:
            scale[k] = share * robust_scale(_pairs(found, k)[: len(used[k])])
        found = as_numpy(adjust(found.unknowns, known._replace(outlier_scale=scale), model=model))
    whitening = np.array(known.points.whitening)
    for k in suspects:
        pairs = _pairs(found, k)[: len(used[k])]
        used[k] = np.linalg.norm(pairs, axis=1) <= GATE * robust_scale(pairs)
        whitening[k, : 2 * len(used[k])][np.repeat(~used[k], 2)] = 0.0
    known = known._replace(points=known.points._replace(whitening=whitening))
    return known, as_numpy(adjust(found.unknowns, known, model=model))


def _jacobian(
    found: Adjusted, known: Views, count: int, model: PoseModel
) -> tuple[Float[np.ndarray, "v m k"], Float[np.ndarray, "k"]]:
    """Of the first `count` cameras by all unknowns, and the information of the priors."""
    lenses, terms = found.unknowns.lens.shape
    poses, rows = count * model.size, found.whitened.shape[1]
    jacobian = np.zeros((count, rows, poses + lenses * terms + len(found.shape)))
    prior = np.ones(jacobian.shape[2])
    prior[:poses] = 0.0
    for k in range(count):
        pose = slice(k * model.size, (k + 1) * model.size)
        lens = poses + int(known.lens_index[k]) * terms
        jacobian[k, :, pose] = found.by_pose[k][:, : model.size]
        jacobian[k, :, lens : lens + terms] = found.by_lens[k] @ known.lens_factor[k]
        jacobian[k, :, poses + lenses * terms :] = found.by_shape[k] * known.shape_sigma
        if model is PoseModel.AIM_FREE:
            distance = float(_pose(found, k).distance_mm)
            prior[pose][4:6] = (known.aim_weight[k] * distance) ** 2
    return jacobian, prior


def _root(
    jacobian: Float[np.ndarray, "v m k"], prior: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "k k"]:
    """R of the information R^T R of all unknowns, the priors included."""
    rows = jacobian.reshape(-1, jacobian.shape[2])
    return _triangle(np.concatenate([rows, np.diag(np.sqrt(prior))]))


def _triangle(rows: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "k k"]:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _reduced_chi_squares(
    found: Adjusted, known: Views, count: int, model: PoseModel
) -> tuple[Float[np.ndarray, "v"], Float[np.ndarray, "v"]]:
    """Chi-square of each camera over its degrees of freedom, and these."""
    jacobian, prior = _jacobian(found, known, count, model)
    inverse = np.linalg.inv(_root(jacobian, prior))
    reduced, freedom = np.full(count, np.nan), np.zeros(count)
    for k, rows in enumerate(jacobian):
        taken = float(np.sum((rows @ inverse) ** 2))
        shown = int((np.asarray(known.points.whitening[k]) != 0).any(axis=1).sum())
        freedom[k] = shown - taken
        if freedom[k] >= 1:
            reduced[k] = float(np.sum(np.square(found.whitened[k]))) / freedom[k]
    return reduced, freedom


def _parameters(poses: Pose, count: int, model: PoseModel) -> Float[np.ndarray, "v p"]:
    """Of the first `count` cameras."""
    return np.asarray(_parameters_of_poses(poses))[:count, : model.size]


_parameters_of_poses = jax.jit(jax.vmap(lambda pose: pose.parameters))


def _pose(found: Adjusted, view: int) -> Pose:
    return jax.tree.map(lambda leaf: leaf[view], found.pose)
