"""Circles that a picture shows elsewhere than noise explains: something else was fitted there."""

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px, inliers
from trinoc.calib.problem.views import NO_PLACE, SheetPoints, View, find_circles

# numerical: of the largest eigenvalue: below, there is no information.
_ROUNDING = 1e-12


def drop_wrong_circles(problem: Problem) -> Problem:
    """The problem without circles whose position by grey levels does not agree with the rig.

    The gate is a multiple of the scatter of all circles of the camera. Circles that were left out
    as points stay left out.
    """
    errors, views = errors_px(problem), list(problem.views)
    for camera in range(problem.cameras):
        own = [k for k, view in enumerate(views) if view.camera == camera and _counts(view)]
        if not own:
            continue
        circles = {k: _circles(views[k], problem) for k in own}
        every = [_in_sigmas(views[k].shown, errors[k], circles[k]) for k in own]
        right = np.split(
            inliers(np.concatenate(every), gate=problem.tuning.problem.gate),
            np.cumsum([len(e) for e in every])[:-1],
        )
        for k, is_right in zip(own, right, strict=True):
            shown, detection = views[k].shown, views[k].detection
            assert shown is not None
            place = find_circles(shown.place_mm[circles[k]], problem.target)
            is_right &= ~np.isin(place, detection.circle_index[~views[k].used])
            if not is_right.all():
                wrong = circles[k][~is_right]
                views[k] = views[k]._replace(shown=discount_points(shown, wrong))
    return problem._replace(views=tuple(views))


def discount_points(shown: SheetPoints, rows: np.ndarray) -> SheetPoints:
    """The same points, some of which may lie anywhere: their information goes."""
    size = len(shown.whitening)
    gone = np.zeros(size, dtype=bool)
    gone[np.concatenate([2 * rows, 2 * rows + 1])] = True
    information = shown.whitening.T @ shown.whitening
    across = information[np.ix_(~gone, gone)]
    inner = np.linalg.pinv(information[np.ix_(gone, gone)], _ROUNDING, hermitian=True)
    values, vectors = np.linalg.eigh(information[np.ix_(~gone, ~gone)] - across @ inner @ across.T)
    determined = values > _ROUNDING * values[-1]
    whitening = np.zeros((size, size))
    root = np.sqrt(values[determined])[:, None] * vectors[:, determined].T
    whitening[: len(root), ~gone] = root
    return shown._replace(whitening=whitening)


def _counts(view: View) -> bool:
    return view.shown is not None and bool(view.used.any())


def _circles(view: View, problem: Problem) -> np.ndarray:
    """Indices of the places that are circles and were reported."""
    assert view.shown is not None
    is_circle = find_circles(view.shown.place_mm, problem.target) != NO_PLACE
    return np.flatnonzero(is_circle & view.kept)


def _in_sigmas(
    shown: SheetPoints | None, errors: Float[np.ndarray, "n 2"], rows: np.ndarray
) -> Float[np.ndarray, "m 2"]:
    """Errors of some points in sigmas of each for itself."""
    assert shown is not None
    information = shown.whitening.T @ shown.whitening
    covariance = np.linalg.pinv(information, _ROUNDING, hermitian=True)
    own = np.stack([covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in rows])
    values, vectors = np.linalg.eigh(own)
    # Of an edge alone, where it lies along itself is not determined.
    determined = values > _ROUNDING * values[:, -1:]
    sigma = np.sqrt(np.where(determined, values, np.inf))
    return np.einsum("kji,kj->ki", vectors, errors[rows]) / sigma
