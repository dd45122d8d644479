"""Laws of the parts: positions and information of strips and lines, the test of two fits, and the
free length beside a segment."""

import jax
import numpy as np
import pytest
from scipy.special import ndtr

from trinoc.match.pixels.measure import fit_lines_to_pixels, hausman
from trinoc.match.pixels.strip_fit import StripFit, fit_strips
from trinoc.match.pixels.strips import COLUMNS, HALF, NO_SEGMENT, ROWS, Strips, segments_near_pixels
from trinoc.match.pixels.tuning import PixelTuning
from trinoc.synth import table1_rig

LINES, BLOCKS, NOISE, BLUR_PX = 150, 6, 2.0, 1.1
LOG_BLUR = float(np.log(BLUR_PX))
PLACE_PX = np.array([0.25, -0.15])


def strips(noise: float, lines: int = LINES) -> Strips:
    """Strips of one step that differ only by their noise."""
    row, column = np.mgrid[: BLOCKS * ROWS, :COLUMNS].astype(float)
    across, share = 0.97 * (column - HALF) - 0.02 * row, (row + 0.5) / len(row)
    shift = (1 - share) * PLACE_PX[0] + share * PLACE_PX[1]
    level = 60 + 70 * ndtr((across - shift) / BLUR_PX)
    levels = level + noise * np.random.default_rng(8).normal(size=(lines, *level.shape))

    def blocks(of: np.ndarray) -> np.ndarray:
        return np.tile(of, (lines, 1, 1)).reshape(lines * BLOCKS, ROWS, COLUMNS)

    usable = np.ones((lines * BLOCKS, ROWS, COLUMNS), dtype=bool)
    owner = np.repeat(np.arange(lines), BLOCKS)
    return Strips(blocks(across), blocks(share), levels.reshape(usable.shape), usable, owner)


def fitted(of: Strips, known_blur: float, log_blur: float = LOG_BLUR) -> StripFit:
    start = np.tile(PLACE_PX, (int(of.line[-1]) + 1, 1))
    with jax.enable_x64(True):
        return fit_strips(of, start, NOISE, (log_blur, known_blur), PixelTuning())


def test_places_of_strips_scatter_as_their_information_says() -> None:
    fit = fitted(strips(NOISE), known_blur=10.0)
    off = fit.parameters - [*PLACE_PX, LOG_BLUR]
    square = np.einsum("ni,nij,nj->n", off, fit.information, off)
    # Three unknowns; the noise of each line is estimated, and blocks off it count a little less.
    assert square.mean() == pytest.approx(3.0, abs=0.6)
    assert fit.chi_square.mean() == pytest.approx(1.0, abs=0.05)
    assert (fit.blocks == BLOCKS).mean() > 0.95


def test_what_is_known_of_the_blur_is_used_and_not_handed_on() -> None:
    """If pixels and prior are equally informative, the fitted blur is the mean of both. The
    reported information is that of the pixels alone."""
    same = strips(NOISE)
    free = fitted(same, known_blur=10.0)
    of_blur = 1 / np.linalg.inv(free.information)[:, 2, 2].mean()
    prior_log_blur = LOG_BLUR + 0.04
    with_prior = fitted(same, 1 / np.sqrt(of_blur), prior_log_blur)
    between = (with_prior.parameters[:, 2] - free.parameters[:, 2]) / (
        prior_log_blur - free.parameters[:, 2]
    )
    assert np.median(between) == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose(
        with_prior.information.mean(axis=0), free.information.mean(axis=0), rtol=0.1, atol=50.0
    )


def images_of(ends: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Projection matrices, images of the ends in each view, and unit normals to their right."""
    rig = table1_rig()
    matrices = np.stack([np.asarray(rig[name].matrix_px) for name in rig.names])
    image = np.einsum("vij,ej->vei", matrices[:, :, :3], ends) + matrices[:, None, :, 3]
    ends_px = image[..., :2] / image[..., 2:]
    unit = ends_px[:, 1] - ends_px[:, 0]
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    return matrices, ends_px, np.stack([-unit[:, 1], unit[:, 0]], axis=1)


ENDS = np.array([[-10.0, 3.0, 2.0], [25.0, -8.0, 20.0]])
AXES = np.linalg.svd((ENDS[1] - ENDS[0])[None])[2][1:]


def test_a_line_is_found_again_from_its_images() -> None:
    move = np.array([0.4, -0.2, 0.1, 0.3])
    matrices, ends_px, _ = images_of(ENDS + move.reshape(2, 2) @ AXES)
    # Anywhere along them.
    along = ends_px + np.array([[[0.1], [-0.3]]]) * (ends_px[:, 1:] - ends_px[:, :1])
    # A view that does not see it may hold anything.
    along = np.concatenate([along, np.array([[[3.0, 7.0], [1.0, 2.0]]])])
    every = np.concatenate([matrices, matrices[:1]])
    covariance, is_visible = np.tile(np.eye(2), (1, 4, 1, 1)), np.array([[1.0, 1.0, 1.0, 0.0]])
    fit = fit_lines_to_pixels(every, ENDS[None], AXES[None], along[None], covariance, is_visible)
    np.testing.assert_allclose(fit.move_mm[0], move, atol=1e-8)
    assert fit.misfit[0] < 1e-12


def test_lines_scatter_as_their_covariance_says_and_one_view_alone_says_nothing() -> None:
    matrices, ends_px, right = images_of(ENDS)
    count, generator = 800, np.random.default_rng(5)
    view_covariance = (
        np.array([[0.09, 0.04], [0.04, 0.16]]) * np.array([1.0, 4.0, 0.25])[:, None, None]
    )
    root = np.linalg.cholesky(view_covariance)
    off = (root @ generator.normal(size=(count, 3, 2, 1)))[..., 0]
    shown = ends_px + off[..., None] * right[:, None]
    lines = np.tile(ENDS, (count, 1, 1)), np.tile(AXES, (count, 1, 1))
    covariance = np.tile(view_covariance, (count, 1, 1, 1))
    fit = fit_lines_to_pixels(matrices, *lines, shown, covariance, np.ones((count, 3)))
    weight = np.linalg.inv(fit.covariance_mm2)
    square = np.einsum("ni,nij,nj->n", fit.move_mm, weight, fit.move_mm)
    assert square.mean() == pytest.approx(4.0, abs=0.35)
    # Six numbers less four unknowns.
    assert fit.misfit.mean() == pytest.approx(2.0, abs=0.3)
    alone = np.tile([1.0, 0.0, 0.0], (count, 1))
    assert np.isnan(
        fit_lines_to_pixels(matrices, *lines, shown, covariance, alone).covariance_mm2
    ).all()


def test_the_difference_of_two_answers_is_a_chi_square():
    generator = np.random.default_rng(2)
    # A mean of ten, against a mean of the first five: the former is efficient.
    data = generator.normal(size=(4000, 10, 2))
    difference = data.mean(axis=1) - data[:, :5].mean(axis=1)
    usual, efficient = (np.tile(np.eye(2) / n, (4000, 1, 1)) for n in (5, 10))
    square = hausman(difference, usual, efficient, 0.1)
    assert abs(square.mean() - 2) < 0.15
    assert abs(np.mean(square > 5.991) - 0.05) < 0.02


def test_owners_are_the_segments_within_reach():
    ends = np.array([[[20.0, 20.0], [60.0, 20.0]], [[58.0, 26.0], [58.0, 50.0]]])
    first, last = segments_near_pixels(ends, (80, 64), 4.0)
    assert (first[20, 30], last[20, 30]) == (0, 0)
    assert (first[40, 58], last[40, 58]) == (1, 1)
    assert (first[23, 58], last[23, 58]) == (0, 1)
    assert first[40, 20] == last[40, 20] == NO_SEGMENT
    # One beyond the picture owns nothing, and disturbs nothing.
    outside = segments_near_pixels(ends + 500.0, (80, 64), 4.0)
    assert (outside[1] == NO_SEGMENT).all()
