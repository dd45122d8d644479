"""From the circles of many pictures to one judged pose each."""

from collections.abc import Sequence
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection import Detection
from trinoc.calib.model import (
    ANNEALING,
    CircleObservations,
    bucket_size,
    circle_observations,
    inliers,
    is_suspect,
    robust_scale,
    stack_observations,
)
from trinoc.calib.pose.estimate import PoseEstimate, assess
from trinoc.calib.pose.least_squares import (
    CircleFit,
    fit_images_from_circles,
    fit_images_from_lines,
    refit_images,
)
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Intrinsics, PoseModel, stack_lenses
from trinoc.numerics import as_numpy

_Tree = TypeVar("_Tree")


def fit_views(
    detections: Sequence[Detection],
    pattern: Pattern,
    lenses: Sequence[Intrinsics],
    model: PoseModel,
) -> list[PoseEstimate]:
    """One judged pose for each picture, all in one vectorised call.

    Pictures whose crossed lines were seen start from them, the others from their circles.
    Pictures with a circle that does not fit are fitted again with bounded influence, and
    again without the circles that this names.
    """
    if not detections:
        return []
    size = bucket_size(max(len(detection) for detection in detections))
    circles = stack_observations([circle_observations(d, pattern, size) for d in detections])
    lens = stack_lenses([intrinsics.lens for intrinsics in lenses])
    count = len(detections)
    fits = _padded(fit_images_from_lines, (lens, circles), model)
    retry = [k for k in range(count) if _has_failed(fits, k, len(detections[k]))]
    if retry:
        chosen = _rows((lens, circles), retry)
        fits = _better(fits, _padded(fit_images_from_circles, chosen, model), retry)
    used = [np.ones(len(detection), dtype=bool) for detection in detections]
    suspects = [k for k in range(count) if is_suspect(_whitened(fits, k, len(detections[k])))]
    if suspects:
        fits = _refit_robustly(fits, lens, circles, used, suspects, model)
    return [_judged(fits, k, used[k]) for k in range(count)]


def _refit_robustly(
    fits: CircleFit,
    lens: AbstractLens,
    circles: CircleObservations,
    used: list[Bool[np.ndarray, "_m"]],
    suspects: list[int],
    model: PoseModel,
) -> CircleFit:
    """`fits` with the suspect pictures fitted without their outliers, noted in `used`."""
    lens, circles = _rows((lens, circles), suspects)
    part = _rows(fits, suspects)
    counts = [len(used[k]) for k in suspects]
    for factor in ANNEALING:
        scale = [robust_scale(_whitened(part, i, m)) for i, m in enumerate(counts)]
        arguments = (part.pose, lens, circles, factor * np.array(scale))
        part = _padded(refit_images, arguments, model)
    whitening = np.array(circles.whitening)
    for i, k in enumerate(suspects):
        used[k] = inliers(_whitened(part, i, counts[i]))
        whitening[i, : counts[i]][~used[k]] = 0.0
    arguments = (
        part.pose,
        lens,
        circles._replace(whitening=whitening),
        np.full(len(suspects), np.inf),
    )
    return _replaced(fits, _padded(refit_images, arguments, model), suspects)


def _padded(fit, arguments: tuple, model: PoseModel) -> CircleFit:
    """Call a vectorised fit with its first axis padded to a power of two above three."""
    count = len(jax.tree.leaves(arguments)[0])
    target = count if count <= 3 else 1 << (count - 1).bit_length()
    index = np.minimum(np.arange(target), count - 1)
    if target > count:
        arguments = jax.tree.map(lambda leaf: leaf[index], arguments)
    result = as_numpy(fit(*arguments, model=model))
    return jax.tree.map(lambda leaf: leaf[:count], result)


def _rows(tree, rows: list[int]):
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _replaced(fits: CircleFit, part: CircleFit, rows: list[int]) -> CircleFit:
    def replace(all_leaf: np.ndarray, part_leaf: np.ndarray) -> np.ndarray:
        merged = np.array(all_leaf)
        merged[rows] = part_leaf
        return merged

    return jax.tree.map(replace, fits, part)


def _cost(fits: CircleFit, row: int) -> float:
    cost = float(np.sum(fits.whitened[row] ** 2))
    return cost if np.isfinite(cost) and fits.converged[row] else float("inf")


def _better(fits: CircleFit, other: CircleFit, rows: list[int]) -> CircleFit:
    """`fits` with those of `rows` replaced for which `other` reaches a lower cost."""
    chosen = [i for i, row in enumerate(rows) if _cost(other, i) < _cost(fits, row)]
    return _replaced(fits, _rows(other, chosen), [rows[i] for i in chosen])


def _has_failed(fits: CircleFit, row: int, count: int) -> bool:
    """Whether another start may do better: no answer, or one far from most circles."""
    return not np.isfinite(_cost(fits, row)) or robust_scale(_whitened(fits, row, count)) > 10


def _judged(fits: CircleFit, row: int, used: Bool[np.ndarray, "m"]) -> PoseEstimate:
    count = len(used)
    return assess(
        np.asarray(fits.parameters[row]),
        np.asarray(fits.residuals_px[row, :count]),
        np.asarray(fits.whitened[row, :count]),
        np.asarray(fits.information[row]),
        np.asarray(fits.d_parameters_d_delta[row]),
        bool(fits.converged[row]),
        used,
    )


def _whitened(fits: CircleFit, row: int, count: int) -> Float[np.ndarray, "m 2"]:
    return np.asarray(fits.whitened[row, :count])
