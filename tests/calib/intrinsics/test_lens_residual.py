"""The model of a circle's image, and the information that is taken from its derivatives."""

import cv2
import jax
import numpy as np
import pytest

from tests.calib.intrinsics.simulated_lens import (
    LENS,
    SHEET,
    SIZE_PX,
    boundaries_px,
    centres_px,
    detections,
    good_poses,
)
from trinoc.calib.intrinsics.lens_residual import information_of_images, residuals_px, retract_pose
from trinoc.calib.model import circle_observations, stack_observations
from trinoc.geometry import BrownConrady

POSES = np.array(good_poses(count=8))
THE_LENS = BrownConrady.from_parameters(LENS)
SCALE = THE_LENS.parameter_scales(SIZE_PX)
RESIDUALS = jax.jit(residuals_px)
INFORMATION = jax.jit(information_of_images)
MOVED = jax.jit(jax.vmap(retract_pose, in_axes=(0, None)))


def observed(**options):
    items = [circle_observations(d, SHEET, 64) for d in detections(list(POSES), **options)]
    return stack_observations(items)


def test_the_model_agrees_with_an_independent_projection():
    errors = np.asarray(RESIDUALS(THE_LENS, POSES, observed(sigma_px=0.0)))
    used = observed(sigma_px=0.0).whitening[..., 0, 0] > 0
    # The polygon of 200 corners lies inside its curve by 2e-4 of a radius.
    assert np.abs(errors[used]).max() < 1e-4


def test_the_centroid_is_the_centre_of_a_fitted_ellipse():
    for curve, centre in zip(boundaries_px(POSES[0]), centres_px(POSES[0]), strict=True):
        fitted, _, _ = cv2.fitEllipse(curve.astype(np.float32))
        np.testing.assert_allclose(centre, fitted, atol=2e-3)


@pytest.mark.parametrize("unknown", range(15))
def test_information_is_the_square_of_numeric_derivatives(unknown):
    circles = observed()
    information = np.asarray(INFORMATION(THE_LENS, SCALE, POSES, circles))
    step = 1e-5 * np.eye(15)[unknown]

    def whitened(sign):
        poses = np.asarray(MOVED(POSES, sign * step[9:]))
        errors = np.asarray(RESIDUALS(THE_LENS.retract(sign * SCALE * step[:9]), poses, circles))
        return np.einsum("knij,knj->kni", circles.whitening, errors)

    slope = (whitened(1.0) - whitened(-1.0)) / 2e-5
    np.testing.assert_allclose(
        information[:, unknown, unknown], np.sum(slope**2, axis=(1, 2)), rtol=1e-5
    )


def test_no_motion_leaves_a_pose_as_it_is():
    np.testing.assert_allclose(retract_pose(POSES[0], np.zeros(6)), POSES[0], atol=1e-9)
