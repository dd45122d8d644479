"""The covariance of a corner is how far noise moves the best fit of its picture."""

import numpy as np
from scipy.special import ndtr

from trinoc.calib.detection.corners import corner_covariance_px2
from trinoc.calib.detection.search_image import SearchImage
from trinoc.calib.tuning.every_group import TUNING

# So blurred that a gradient over three pixels is that of the edge.
NOISE, BLUR_PX = 3.0, 3.0
# Edges of two slants, so that the covariance is no multiple of the unit matrix.
NORMALS = np.array([[np.cos(0.3), np.sin(0.3)], [np.cos(1.2), np.sin(1.2)]])
CORNERS = np.array([[30.0, 30.0], [60.0, 30.0], [30.0, 60.0], [60.0, 60.0]])
# The detector's own error, as `corners` states it.
FLOOR = TUNING.detection.corner_floor_px**2 * np.eye(2)


def picture_of(corners):
    """Grey levels of corners between two dark and two light fields, each in a tile of its own."""
    row, column = np.indices((91, 91)).astype(float)
    grey = np.full(row.shape, 128.0)
    for u, v in corners:
        tile = (np.abs(column - np.rint(u)) <= 15) & (np.abs(row - np.rint(v)) <= 15)
        along = [(n[0] * (column - u) + n[1] * (row - v)) / BLUR_PX for n in NORMALS]
        edges = (2 * ndtr(along[0]) - 1) * (2 * ndtr(along[1]) - 1)
        grey[tile] = (128.0 + 90.0 * edges)[tile]
    return grey


def test_noise_moves_the_best_fit_of_a_corner_as_far_as_its_covariance_says():
    clean, step = picture_of(CORNERS), 1e-3
    slopes = [
        (picture_of(CORNERS + by) - picture_of(CORNERS - by)) / (2 * step)
        for by in step * np.eye(2)
    ]
    random = np.random.default_rng(0)
    claimed = corner_covariance_px2(SearchImage(clean, NOISE), CORNERS) - FLOOR
    # The window reaches .4 of the way to the next corner.
    half, scaled = 12, []
    for (u, v), covariance in zip(CORNERS.astype(int), claimed, strict=True):
        window = (slice(v - half, v + half + 1), slice(u - half, u + half + 1))
        design = np.stack([slope[window].ravel() for slope in slopes], axis=1)
        noise = random.normal(0.0, NOISE, (4000, len(design)))
        moved = noise @ np.linalg.pinv(design).T
        scaled.append(np.linalg.inv(covariance) @ np.cov(moved.T))
    np.testing.assert_allclose(np.mean(scaled, axis=0), np.eye(2), atol=0.06)
