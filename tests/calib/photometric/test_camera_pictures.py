"""Images of non-ideal cameras: the effects that are detected, and errors of the reported size."""

from collections.abc import Callable

import numpy as np
import pytest

from simulation.camera_picture.delivery import SRGB
from tests.calib.photometric.pictures import RIGHT, image_of
from tests.calib.photometric.test_photometry import START, mahalanobis, refined
from tests.calib.simulated import LENS, reference_sheet
from trinoc.calib.photometric.encoding import Encoding
from trinoc.calib.photometric.image_fit import refine_image
from trinoc.calib.result.degrees import pose_of_values
from trinoc.geometry.pose import PoseModel


def srgb(light: np.ndarray) -> np.ndarray:
    return 255 * np.asarray(SRGB().encode(np.clip(light / 255, 0, 1)))


def overexposed(light: np.ndarray) -> np.ndarray:
    return np.minimum(1.4 * light, 255.0)


PICTURES = {"as sRGB": srgb, "saturated": overexposed}


@pytest.mark.slow
@pytest.mark.parametrize("word", ["as sRGB", "saturated"])
def test_errors_scatter_as_the_covariance_says(word: str) -> None:
    camera: Callable[[np.ndarray], np.ndarray] = PICTURES[word]
    exact, trials, squared = image_of(reference_sheet(), RIGHT, supersampling=24), 8, []
    for seed in range(trials):
        noise = np.random.default_rng(seed).normal(0.0, 2.0, exact.shape)
        result = refined(np.rint(camera(exact + noise)).astype(np.float32), START)
        assert result is not None
        assert any(word in effect for effect in result.effects)
        squared.append(mahalanobis(result))
    assert abs(np.mean(squared) - 4) < 3.5 * np.sqrt(2 * 4 / trials)


@pytest.mark.slow
def test_a_known_response_is_not_fitted() -> None:
    exact = image_of(reference_sheet(), RIGHT, supersampling=24)
    noise = np.random.default_rng(0).normal(0.0, 2.0, exact.shape)
    picture = np.rint(srgb(exact + noise)).astype(np.float32)
    pose = pose_of_values(np.array(START))
    with_response, fitted = (
        refine_image(
            picture, reference_sheet(), LENS.lens, pose, PoseModel.AIMED, encoding=encoding
        )
        for encoding in (Encoding(response="srgb"), Encoding())
    )
    assert with_response is not None
    assert fitted is not None
    assert with_response.effects == ()
    assert mahalanobis(with_response) < 20.0
    # A known response costs no information.
    assert np.trace(with_response.information) > np.trace(fitted.information)


def test_a_clean_picture_takes_the_simple_model() -> None:
    exact = image_of(reference_sheet(), RIGHT)
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(0.0, 2.0, exact.shape)
        result = refined(np.rint(exact + noise).astype(np.float32), START)
        assert result is not None
        assert result.effects == ()
        assert result.noise == pytest.approx(2.0, rel=0.06)


def test_a_raw_mosaic_is_fitted_without_interpolation() -> None:
    exact = image_of(reference_sheet(), RIGHT)
    row, column = np.mgrid[: exact.shape[0], : exact.shape[1]] % 2
    gain = np.array([[0.55, 1.0], [1.0, 0.65]])[row, column]
    raw = exact * gain + np.random.default_rng(0).normal(0.0, 1.0, exact.shape)
    arguments = (reference_sheet(), LENS.lens, pose_of_values(np.array(START)), PoseModel.AIMED)
    balanced = refine_image(raw.astype(np.float32), *arguments, encoding=Encoding("RGGB"))
    assert balanced is not None
    assert mahalanobis(balanced) < 25.0
