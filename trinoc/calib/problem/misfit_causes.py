"""Causes of residuals that exceed their sigmas, with their size in pixels.

Four causes leave four patterns in the residuals of a rig from shots:

- Wrong lens model: a pattern fixed in the image of a camera, the same in all shots.
- Board of changing shape (paper in the hand), or moving while a rolling shutter reads the image: a
  smooth pattern over the board that differs from image to image.
- Unsynchronised cameras: the board's pose differs between the cameras of a shot.
- One camera moved during the recording: that difference changes once and stays.

As in an analysis of variance, each pattern is compared with its expectation under noise alone. Its
amplitude is the root mean square length in pixels, minus the noise's share.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.moments import (
    ImagePoses,
    errors_about_image_poses_px,
    fit_image_poses,
    pose_differences_px,
)
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.tuning.every_group import TUNING

# numerical: cells of the image along each side in which a lens's pattern is averaged, and the
# fewest images that show a cell.
_CELLS, _FEWEST_IMAGES = 8, 3
# numerical: fewer shots on one side of a change do not show that a camera moved.
_FEWEST_SHOTS = 3
# numerical: parameters of a smooth pattern of second degree, and those that a pose absorbs.
_SMOOTH, _ABSORBED = 12, 6


class CauseKind(Enum):
    """Kind of cause of residuals that are larger than their sigmas."""

    LENS_MODEL = "lens model"
    BOARD_CHANGES = "board changes"
    MOMENTS_DIFFER = "moments differ"
    CAMERA_MOVED = "camera moved"


class MisfitCause(NamedTuple):
    """A systematic pattern in the residuals of one camera, which explains part of their size.

    Attributes
    ----------
    kind : kind of cause.
    camera : index of the camera with the pattern.
    amplitude_px : root mean square length of the pattern in the image. For a moved camera: shift of
        its image by the motion.
    noise_px : root mean square length of all residuals of the camera.
    shot : for a moved camera, index of the first shot after the motion; else -1.
    """

    kind: CauseKind
    camera: int
    amplitude_px: float
    noise_px: float
    shot: int = -1


def find_causes(problem: Problem) -> list[MisfitCause]:
    """Find the causes that explain a relevant share of the residuals. The largest one
    comes first.
    """
    causes, poses, tuning = [], fit_image_poses(problem), problem.tuning.answer
    # Each image has its own pose, in case the cameras are not synchronised.
    errors = errors_about_image_poses_px(problem, poses)
    for camera in range(problem.cameras):
        rows = [
            k
            for k, view in enumerate(problem.views)
            if view.camera == camera and view.row_count == len(view.used) and view.used.any()
        ]
        if len(rows) < _FEWEST_IMAGES:
            continue
        residuals = [errors[k][problem.views[k].used] for k in rows]
        pixels = [problem.views[k].detection.centres_px[problem.views[k].used] for k in rows]
        board_mm = [
            problem.target.centres_mm[problem.views[k].detection.circle_index][
                problem.views[k].used
            ]
            for k in rows
        ]
        noise_px = float(np.sqrt(np.mean(np.sum(np.concatenate(residuals) ** 2, axis=1))))
        size_px = problem.views[rows[0]].detection.image_size_px
        patterns = {
            CauseKind.LENS_MODEL: lens_pattern_px(residuals, pixels, size_px, tuning.named_ratio),
            CauseKind.BOARD_CHANGES: smooth_pattern_px(residuals, board_mm, tuning.named_ratio),
        }
        least_px = max(tuning.named_share * noise_px, tuning.least_shift_px)
        causes += [
            MisfitCause(kind, camera, amplitude_px, noise_px)
            for kind, amplitude_px in patterns.items()
            if amplitude_px > least_px
        ]
    causes += _causes_of_moments(problem, poses)
    return sorted(causes, key=lambda cause: -cause.amplitude_px)


def lens_pattern_px(
    residuals: Sequence[Float[np.ndarray, "_m 2"]],
    observed_px: Sequence[Float[np.ndarray, "_m 2"]],
    size_px: tuple[int, int],
    named_ratio: float = TUNING.answer.named_ratio,
) -> float:
    """Root mean square length, px, of the residual pattern that all images of one camera have in
    common.

    0 if noise explains the pattern. The image is divided into cells. Residuals are averaged in each
    cell, first within each image, then over the images. The scatter of a cell's mean between images
    is its noise.

    Parameters
    ----------
    residuals : (m, 2) residuals of each image, px.
    observed_px : (m, 2) pixels at which these residuals were observed.
    size_px : (width, height) of the images.
    named_ratio : F ratio below which noise explains the pattern.
    """
    cell_of = [
        np.minimum((pixels / size_px * _CELLS).clip(0), _CELLS - 1).astype(int)
        @ np.array([1, _CELLS])
        for pixels in observed_px
    ]
    sums = np.zeros((len(residuals), _CELLS**2, 2))
    counts = np.zeros((len(residuals), _CELLS**2))
    for image, (cell, image_residuals) in enumerate(zip(cell_of, residuals, strict=True)):
        np.add.at(sums[image], cell, image_residuals)
        np.add.at(counts[image], cell, 1)
    excess, weight, score, freedom = 0.0, 0.0, 0.0, 0
    for cell in np.flatnonzero((counts > 0).sum(axis=0) >= _FEWEST_IMAGES):
        shows_cell = counts[:, cell] > 0
        means = sums[shows_cell, cell] / counts[shows_cell, cell, None]
        variance = means.var(axis=0, ddof=1).sum() / len(means)
        square = float(np.sum(means.mean(axis=0) ** 2))
        count = counts[:, cell].sum()
        excess, weight = excess + count * (square - variance), weight + count
        score, freedom = score + 2 * square / max(variance, 1e-300), freedom + 2
    # Means of few images: a cell's ratio is an F statistic, whose mean is (n - 1) / (n - 3).
    if freedom < 8 or score / freedom < named_ratio or excess <= 0:
        return 0.0
    return float(np.sqrt(excess / weight))


def smooth_pattern_px(
    residuals: Sequence[Float[np.ndarray, "_m 2"]],
    board_mm: Sequence[Float[np.ndarray, "_m 2"]],
    named_ratio: float = TUNING.answer.named_ratio,
) -> float:
    """Root mean square length, px, of a smooth residual pattern over the board that differs between
    images.

    In each image, u and v residuals are fitted by a polynomial of second degree in the board's X
    and Y (12 parameters; the board pose absorbs 6 of them). 0 if noise explains the pattern.

    Parameters
    ----------
    residuals : (m, 2) residuals of each image, px.
    board_mm : (m, 2) positions of these points on the board.
    named_ratio : noise explains the pattern if its sum of squares is below this multiple of the
        expectation under noise.
    """
    explained, unexplained, freedom, count = 0.0, 0.0, 0, 0
    for image_residuals, points in zip(residuals, board_mm, strict=True):
        if 2 * len(image_residuals) <= 2 * _SMOOTH:
            continue
        x, y = ((points - points.mean(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-9)).T
        basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        orthonormal, _ = np.linalg.qr(basis)
        square = float(np.sum((orthonormal.T @ image_residuals) ** 2))
        explained, unexplained = (
            explained + square,
            unexplained + float(np.sum(image_residuals**2)) - square,
        )
        freedom, count = freedom + 2 * len(image_residuals) - _SMOOTH, count + 1
    if not count or freedom <= 0:
        return 0.0
    variance = unexplained / freedom
    expected = (_SMOOTH - _ABSORBED) * count * variance
    if explained < named_ratio * expected:
        return 0.0
    return float(np.sqrt((explained - expected) / sum(map(len, residuals))))


def _causes_of_moments(problem: Problem, poses: ImagePoses) -> list[MisfitCause]:
    causes, errors, tuning = [], errors_px(problem), problem.tuning.answer
    for camera, (shots, shifts_px) in pose_differences_px(problem, poses).items():
        rows = [k for k, v in enumerate(problem.views) if v.camera == camera and v.used.any()]
        residuals = np.concatenate([errors[k][problem.views[k].rows_used] for k in rows])
        noise_px = float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))
        change = change_point(shifts_px, tuning.moved_scatters)
        if change is not None:
            index, distance_px = change
            causes.append(
                MisfitCause(
                    CauseKind.CAMERA_MOVED, camera, distance_px, noise_px, int(shots[index])
                )
            )
            continue
        typical_px = float(np.median(np.linalg.norm(shifts_px, axis=1)))
        if typical_px > max(tuning.named_share * noise_px, tuning.least_shift_px):
            causes.append(MisfitCause(CauseKind.MOMENTS_DIFFER, camera, typical_px, noise_px))
    return causes


def change_point(
    shifts_px: Float[np.ndarray, "s 2"], moved_scatters: float = TUNING.answer.moved_scatters
) -> tuple[int, float] | None:
    """Find a single jump in a sequence of image shifts of one camera.

    Returns the index of the first shot after the jump and the length of the jump, px. None if the
    jump is not much larger than the scatter before and after it.

    shifts_px : (s, 2) shift of the board's image in each shot, relative to the other cameras.
    """
    splits = range(_FEWEST_SHOTS, len(shifts_px) - _FEWEST_SHOTS + 1)
    if not splits:
        return None

    def parts(index: int) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "s 2"]]:
        """Median after a split minus median before it, and all deviations from these
        two medians.
        """
        sides = shifts_px[:index], shifts_px[index:]
        middles = [np.median(side, axis=0) for side in sides]
        return middles[1] - middles[0], np.concatenate([s - m for s, m in zip(sides, middles)])

    index = min(splits, key=lambda index: float(np.sum(parts(index)[1] ** 2)))
    jump, remainder = parts(index)
    size_px = float(np.linalg.norm(jump))
    scatter_px = float(np.median(np.linalg.norm(remainder, axis=1)))
    return (index, size_px) if size_px > moved_scatters * scatter_px else None
