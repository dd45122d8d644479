"""Removal of outlier circles from the fit to grey levels."""

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px, inliers
from trinoc.calib.problem.views import NO_POINT, BoardObservation, SheetPoints, find_circles

# numerical: eigenvalues below this share of the largest one are rounding.
_ROUNDING = 1e-12


def drop_wrong_circles(problem: Problem) -> Problem:
    """Remove circles whose grey-level position is an outlier with respect to the fitted rig.

    The largest accepted error is a multiple of the scatter of all circles of the camera. Circles
    that were outliers in the fit to detected points remain excluded.
    """
    errors, views = errors_px(problem), list(problem.views)
    for camera in range(problem.cameras):
        camera_views = [
            k
            for k, view in enumerate(views)
            if view.camera == camera and _has_grey_level_points(view)
        ]
        if not camera_views:
            continue
        circles = {k: _circles(views[k], problem) for k in camera_views}
        whitened = [
            _in_sigmas(views[k].grey_level_points, errors[k], circles[k]) for k in camera_views
        ]
        inlier_masks = np.split(
            inliers(np.concatenate(whitened), gate=problem.tuning.problem.gate),
            np.cumsum([len(e) for e in whitened])[:-1],
        )
        for k, is_right in zip(camera_views, inlier_masks, strict=True):
            points, detection = views[k].grey_level_points, views[k].detection
            assert points is not None
            circle = find_circles(points.point_mm[circles[k]], problem.target)
            is_right &= ~np.isin(circle, detection.circle_index[~views[k].used])
            if not is_right.all():
                wrong = circles[k][~is_right]
                views[k] = views[k]._replace(grey_level_points=discount_points(points, wrong))
    return problem._replace(views=tuple(views))


def discount_points(points: SheetPoints, rows: np.ndarray) -> SheetPoints:
    """Copy of the points in which the pixels of some carry no information.

    These pixels are marginalised out of the joint information of all pixels.

    rows : indices of the points that lose their information.
    """
    size = len(points.whitening)
    removed = np.zeros(size, dtype=bool)
    removed[np.concatenate([2 * rows, 2 * rows + 1])] = True
    information = points.whitening.T @ points.whitening
    coupling = information[np.ix_(~removed, removed)]
    inner = np.linalg.pinv(information[np.ix_(removed, removed)], _ROUNDING, hermitian=True)
    values, vectors = np.linalg.eigh(
        information[np.ix_(~removed, ~removed)] - coupling @ inner @ coupling.T
    )
    determined = values > _ROUNDING * values[-1]
    whitening = np.zeros((size, size))
    root = np.sqrt(values[determined])[:, None] * vectors[:, determined].T
    whitening[: len(root), ~removed] = root
    return points._replace(whitening=whitening)


def _has_grey_level_points(view: BoardObservation) -> bool:
    return view.grey_level_points is not None and bool(view.used.any())


def _circles(view: BoardObservation, problem: Problem) -> np.ndarray:
    """Indices of those grey-level points of an observation that are circles and that are used."""
    assert view.grey_level_points is not None
    is_circle = find_circles(view.grey_level_points.point_mm, problem.target) != NO_POINT
    return np.flatnonzero(is_circle & view.rows_used)


def _in_sigmas(
    points: SheetPoints | None, errors: Float[np.ndarray, "n 2"], rows: np.ndarray
) -> Float[np.ndarray, "m 2"]:
    """Errors of the points `rows`, along the principal axes of their covariance, in
    sigmas, (m, 2).
    """
    assert points is not None
    information = points.whitening.T @ points.whitening
    covariance = np.linalg.pinv(information, _ROUNDING, hermitian=True)
    point_covariance = np.stack([covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in rows])
    values, vectors = np.linalg.eigh(point_covariance)
    # The position of an edge along itself is not determined.
    determined = values > _ROUNDING * values[:, -1:]
    sigma = np.sqrt(np.where(determined, values, np.inf))
    return np.einsum("kji,kj->ki", vectors, errors[rows]) / sigma
