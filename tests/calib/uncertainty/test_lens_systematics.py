"""The given covariance of the lens changes the pose covariance as fits with moved lenses do."""

import dataclasses

import numpy as np
import pytest

from tests.calib.simulated import (
    EXACT,
    LENS,
    TABLE_1,
    camera_of,
    reference_sheet,
    simulated_detection,
)
from trinoc.calib import (
    Status,
    calibrate_detections,
    with_systematics,
)
from trinoc.calib.uncertainty import systematics
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics

SHEET = reference_sheet()
# fu, fv, cu, cv: the focal lengths correlated, as lenses are known.
SIGMA = np.array([0.3, 0.3, 0.1, 0.1])
CORRELATION = np.eye(4)
CORRELATION[0, 1] = CORRELATION[1, 0] = 0.9
COVARIANCE = SIGMA[:, None] * CORRELATION * SIGMA


def moved(change: np.ndarray) -> Intrinsics:
    return Intrinsics(
        focal_length_px=np.asarray(LENS.focal_length_px) + change[:2],
        principal_point_px=np.asarray(LENS.principal_point_px) + change[2:4],
        image_size_px=LENS.image_size_px,
    )


def spread(fit, step: float) -> np.ndarray:
    """J Sigma J^T with J by finite differences of `fit` under a changed lens."""
    columns = [(fit(moved(h)) - fit(moved(-h))) / 2 for h in step * np.diag(SIGMA)]
    jacobian = np.stack(columns, axis=1) / (step * SIGMA)
    return jacobian @ COVARIANCE @ jacobian.T


@pytest.fixture(scope="module")
def exact():
    detections = {
        name: simulated_detection(camera_of(values), SHEET, seed=k)
        for k, (name, values) in enumerate(TABLE_1.items())
    }
    return calibrate_detections(detections, SHEET, LENS, systematics=EXACT)


def test_a_sheet_that_is_larger_is_seen_from_farther_by_all_alike(exact) -> None:
    """The size of the sheet changes all distances in proportion, and nothing else."""
    wide = with_systematics(exact, Systematics(print_size_sigma=1e-3))
    distances = [1e-3 * exact.rig[name].distance_mm for name in exact.rig.names]
    by_size = np.kron(distances, [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        wide.covariance - exact.covariance, np.outer(by_size, by_size), atol=1e-6
    )


def bent_sheet(term: int, size: float) -> np.ndarray:
    """Centres (n, 3) of the circles of a sheet stretched along X or Y, or bent along X, Y, both."""
    x, y = SHEET.centres_mm.T
    reach = np.hypot(x, y).max()
    along = [1 + size * (term == k) for k in (0, 1)]
    heights = [0, 0, (x / reach) ** 2, (y / reach) ** 2, x * y / reach**2]
    return np.stack([along[0] * x, along[1] * y, size * heights[term] + 0 * x], axis=1)


def test_scale_and_bend_of_the_sheet_reach_the_poses_as_fits_to_such_a_sheet(exact) -> None:
    sigmas = np.array([1e-3, 3e-4, 0.1, 0.1, 0.1])
    sheet_systematics = Systematics(print_scale_sigma=(1e-3, 3e-4), flatness_mm=0.1)

    def images(name: str, points_mm: np.ndarray) -> np.ndarray:
        image = points_mm @ (matrix := exact.rig[name].matrix_px)[:, :3].T + matrix[:, 3]
        return image[:, :2] / image[:, 2:]

    def fit(term: int, size: float) -> np.ndarray:
        shown = {}
        for name, camera_fit in exact.fits.items():
            moved_px = images(name, bent_sheet(term, size)) - images(name, bent_sheet(term, 0.0))
            detection = camera_fit.detection
            shown[name] = dataclasses.replace(detection, centres_px=detection.centres_px + moved_px)
        return calibrate_detections(shown, SHEET, LENS, systematics=EXACT).values

    # Small enough that no fit takes its circles for wrong.
    columns = [
        sigma * (fit(term, 0.02 * sigma) - fit(term, -0.02 * sigma)) / (0.04 * sigma)
        for term, sigma in enumerate(sigmas)
    ]
    expected = sum(np.outer(column, column) for column in columns)
    scale = np.sqrt(np.diag(expected))
    added = with_systematics(exact, sheet_systematics).covariance - exact.covariance
    np.testing.assert_allclose(
        added / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.01
    )


def test_one_lens_errs_for_all_cameras_and_lenses_of_their_own_for_each(exact) -> None:
    one, separate = (
        with_systematics(exact, Systematics(lens_covariance=lens_covariance)).covariance
        - exact.covariance
        for lens_covariance in (COVARIANCE, dict.fromkeys(TABLE_1, COVARIANCE))
    )
    between = np.kron(np.ones((3, 3)) - np.eye(3), np.ones((4, 4))) > 0
    np.testing.assert_allclose(separate[~between], one[~between], rtol=1e-9)
    np.testing.assert_array_equal(separate[between], 0.0)
    assert np.abs(one[3, 7]) > 0.1 * one[3, 3]


@pytest.mark.slow
def test_the_term_is_that_of_fits_with_a_moved_lens() -> None:
    detections = {
        name: simulated_detection(camera_of(values), SHEET, seed=k)
        for k, (name, values) in enumerate(TABLE_1.items())
    }

    def fit(lens: Intrinsics) -> np.ndarray:
        return calibrate_detections(detections, SHEET, lens, systematics=EXACT).values

    plain = calibrate_detections(detections, SHEET, LENS, systematics=EXACT)
    wide = with_systematics(plain, Systematics(lens_covariance=COVARIANCE))
    # One lens for all cameras: its error is theirs in common, so the blocks between them count.
    scale = np.sqrt(np.diag(wide.covariance))
    np.testing.assert_allclose(
        (wide.covariance - plain.covariance) / np.outer(scale, scale),
        spread(fit, 1.0) / np.outer(scale, scale),
        atol=2e-3,
    )
    np.testing.assert_array_equal(wide.values, plain.values)


@pytest.mark.slow
def test_lenses_of_their_own_err_independently() -> None:
    detections = {
        name: simulated_detection(camera_of(TABLE_1[name]), SHEET, seed=3) for name in TABLE_1
    }
    lens_systematics = Systematics(lens_covariance={"upper": COVARIANCE, "left": COVARIANCE})
    result = calibrate_detections(detections, SHEET, LENS, systematics=lens_systematics)
    plain = calibrate_detections(detections, SHEET, LENS, systematics=EXACT)
    scale = np.sqrt(np.diag(result.covariance))
    np.testing.assert_allclose((result.covariance / np.outer(scale, scale))[:4, 4:], 0, atol=1e-9)
    assert result.sigma("upper.distance_mm") > 5 * plain.sigma("upper.distance_mm")
    sigma_ratio = result.sigma("right.distance_mm") / plain.sigma("right.distance_mm")
    assert sigma_ratio == pytest.approx(1, rel=1e-6)
    assert "sigmas include noise, the lens covariance of upper, left." in result.summary()


@pytest.mark.slow
def test_errors_of_the_lens_scatter_the_pose_as_claimed() -> None:
    """100 lenses drawn from the covariance: normalised squared errors are chi-square.

    A principal point further off than the circles' noise would show in the residuals, and
    enlarge the sigma of the noise, too.
    """
    random = np.random.default_rng(7)
    camera = camera_of(TABLE_1["upper"])
    covariance = COVARIANCE.copy()
    covariance[2:, 2:] *= 0.03**2
    factor = np.linalg.cholesky(covariance)
    lens_systematics = Systematics(lens_covariance=covariance)
    squared = []
    for k in range(100):
        detection = simulated_detection(camera, SHEET, seed=k)
        lens = moved(factor @ random.normal(size=4))
        result = calibrate_detections({"a": detection}, SHEET, lens, systematics=lens_systematics)
        error = result.values - TABLE_1["upper"]
        squared.append(error @ np.linalg.solve(result.covariance, error))
    # The mean of 100 chi-square numbers of four degrees of freedom, within four sigmas.
    assert abs(np.mean(squared) - 4) < 4 * np.sqrt(2 * 4 / 100)


@pytest.mark.slow
def test_a_lens_off_by_its_own_sigma_is_not_suspect() -> None:
    detection = simulated_detection(camera_of(TABLE_1["left"]), SHEET, seed=0, sigma_px=0.002)
    focal = np.asarray(LENS.focal_length_px)
    long = moved(np.array([*(0.003 * focal), 0.0, 0.0]))
    lens_systematics = Systematics(lens_covariance=np.outer([3.0, 3.6], [3.0, 3.6]))
    plain = calibrate_detections({"a": detection}, SHEET, long, systematics=EXACT)
    wide = calibrate_detections({"a": detection}, SHEET, long, systematics=lens_systematics)
    assert plain.status["a"] is Status.SUSPECT
    assert wide.status["a"] is Status.CONVERGED
    # The circles tell the focal length better than the data sheet did.
    focal_px = float(wide.rig["a"].intrinsics.focal_length_px[0])
    sigma = wide.sigma("a.fx_px")
    assert sigma < 1.0
    assert abs(focal_px - focal[0]) < 4 * sigma


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.full((4, 4), np.nan), "not finite"),
        (np.zeros((2, 3)), "shape"),
        ({"lower": COVARIANCE}, 'names the camera "lower"'),
    ],
)
def test_what_is_no_lens_covariance_is_refused(covariance, message: str) -> None:
    detection = simulated_detection(camera_of(TABLE_1["upper"]), SHEET, seed=0)
    with pytest.raises(InputError, match=message):
        calibrate_detections(
            {"a": detection}, SHEET, LENS, systematics=Systematics(lens_covariance=covariance)
        )


def test_directions_of_a_lens_covariance_make_it_up() -> None:
    root = np.random.default_rng(3).normal(size=(5, 2)) * [[100.0], [100.0], [1.0], [1.0], [0.0]]
    factor = systematics._factor(root @ root.T)
    assert factor.shape == (5, 2)
    np.testing.assert_allclose(factor @ factor.T, root @ root.T, rtol=1e-9, atol=1e-9)
