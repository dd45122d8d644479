"""Errors of corners follow their reported covariance, for any noise of the image."""

import cv2
import numpy as np
import pytest

from trinoc.calib.detection.corner_fit import fit_corners
from trinoc.calib.detection.search_image import search_image
from trinoc.calib.tuning.every_group import TUNING

FINER, TILE_PX, EACH_WAY, RADIUS_PX = 6, 27, 11, 9.5
# Sigmas are right to a quarter: those of 121 corners together are known to .05.
QUARTER = 1.25


def picture(*, blur_px=0.8, slope=0.0, seed=0):
    """(noiseless image, corners) of tiles with a corner each, at random angles, supersampled."""
    random = np.random.default_rng(seed)
    fine = np.arange(FINER * TILE_PX)
    pixel = (fine + 0.5) / FINER - 0.5
    corners_px, rows = [], []
    for row in range(EACH_WAY):
        tiles = []
        for column in range(EACH_WAY):
            corner_px = (TILE_PX - 1) / 2 + random.uniform(-0.5, 0.5, 2)
            first = random.uniform(0, np.pi)
            between = random.uniform(np.radians(60), np.radians(120))
            u, v = pixel[None] - corner_px[0], pixel[:, None] - corner_px[1]
            # By how much of a fine pixel lies on either side of each edge.
            one, other = (
                np.clip(2 * FINER * (np.cos(turn) * u + np.sin(turn) * v), -1, 1)
                for turn in (first, first + between)
            )
            tiles.append(0.475 + 0.325 * one * other)
            corners_px.append(corner_px + TILE_PX * np.array([column, row]))
        rows.append(np.concatenate(tiles, axis=1))
    sharp = cv2.GaussianBlur(np.concatenate(rows), (0, 0), FINER * blur_px)
    side = EACH_WAY * TILE_PX
    light = sharp.reshape(side, FINER, side, FINER).mean(axis=(1, 3))
    return light * (1 + slope * np.linspace(-1, 1, side)), np.array(corners_px)


def white(light, random):
    return 255 * light + random.normal(0, 4, light.shape)


def shared(light, random):
    """Image with noise that neighbours share, as denoising and demosaicing make it."""
    return 255 * light + cv2.GaussianBlur(random.normal(0, 8, light.shape), (0, 0), 0.6)


def of_light(light, random):
    """Image with a noise variance in proportion to the light, as shot noise has."""
    return 255 * light + random.normal(0, 1, light.shape) * np.sqrt(60 * light)


def of_edges(light, random):
    """Image with more noise on edges, as from flickering air or a wrong model there."""
    slope = np.hypot(*np.gradient(light))
    return 255 * light + random.normal(0, 1, light.shape) * (1 + 15 * slope)


def bent(light, random):
    return 255 * (light + random.normal(0, 0.01, light.shape)).clip(0, 1) ** (1 / 2.2)


def overexposed(light, random):
    return (330 * light + random.normal(0, 2, light.shape)).clip(0, 255)


def sharpened(light, random):
    grey = 255 * light + random.normal(0, 2, light.shape)
    return grey + 0.8 * (grey - cv2.GaussianBlur(grey, (0, 0), 1.0))


LOOKS = [{}, {"blur_px": 0.3}, {"blur_px": 1.6, "slope": 0.3}]
OF_NOISE = [
    (deliver, look) for deliver in (white, shared, of_light, of_edges, bent) for look in LOOKS
]
# The effects that the model omits are symmetric about a corner.
OF_LIGHT = [(overexposed, {}), (sharpened, {})]


@pytest.mark.parametrize(("deliver", "look"), [*OF_NOISE, *OF_LIGHT])
def test_corners_are_off_by_what_they_claim(deliver, look):
    light, corners = picture(**look)
    start = corners + np.random.default_rng(2).normal(0, 0.15, corners.shape)
    squares = []
    for seed in (1, 5):
        grey = deliver(light, np.random.default_rng(seed))
        fit = fit_corners(search_image(grey), start, np.full(len(corners), RADIUS_PX), TUNING)
        off = fit.corners_px - corners
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(fit.covariance_px2), off))
    assert 1 / QUARTER < np.sqrt(np.mean(squares) / 2) < QUARTER


def test_a_window_without_information_spoils_no_other():
    """One window is a constant grey or has one wild pixel.

    The other windows keep their covariance, and every covariance is finite.
    """
    light, corners = picture()
    grey = white(light, np.random.default_rng(1))
    radius_px = np.full(len(corners), RADIUS_PX)
    before = fit_corners(search_image(grey), corners, radius_px, TUNING)
    x, y = np.rint(corners[5]).astype(int)
    for spoil in (120.0, 1e6):
        spoilt = grey.copy()
        spoilt[y - 12 : y + 13, x - 12 : x + 13] = 120.0
        spoilt[y, x] = spoil
        after = fit_corners(search_image(spoilt), corners, radius_px, TUNING)
        assert np.isfinite(after.covariance_px2).all()
        assert np.linalg.eigvalsh(after.covariance_px2).min() > 0
        is_neighbour = np.linalg.norm(corners - corners[5], axis=1) < 40
        ratio = np.linalg.det(after.covariance_px2) / np.linalg.det(before.covariance_px2)
        assert np.all(np.abs(np.log(ratio[~is_neighbour])) < np.log(2.0))


def test_where_there_is_no_corner_the_start_is_kept_and_says_little():
    grey = np.full((60, 90), 120.0)
    grey[:, :60] += np.random.default_rng(0).normal(0, 3, (60, 60))
    start = np.array([[20.3, 20.6], [40.2, 41.0], [0.5, 58.0], [75.1, 30.0]])
    fit = fit_corners(search_image(grey), start, np.full(4, RADIUS_PX), TUNING)
    assert np.linalg.norm(fit.corners_px - start, axis=1).max() < 0.5 * RADIUS_PX
    assert np.isfinite(fit.covariance_px2).all()
    assert np.sqrt(np.linalg.eigvalsh(fit.covariance_px2)[:, 1]).min() > 0.5
