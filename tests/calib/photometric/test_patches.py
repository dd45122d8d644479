"""Displacements of patches and their information equal those of dense least squares."""

from typing import Any

import numpy as np
import pytest
import scipy.sparse

from tests.calib.photometric.pictures import RIGHT, state_at
from trinoc.calib.photometric.equations import PixelRows, Prediction
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.patches import (
    _displacements,
    _renumber_patches,
    _shared_unknowns,
    _SharedUnknowns,
)
from trinoc.calib.photometric.scene import Blocks, PixelScene
from trinoc.calib.photometric.unknowns import (
    LOCAL_TERMS,
    ImageState,
    full_state,
)
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.pose import PoseModel


def test_shifts_and_their_information_are_those_of_all_unknowns_together() -> None:
    random = np.random.default_rng(0)
    pixels, patches = 60, 4
    patch = np.arange(pixels) % patches
    by_px, residual = random.normal(size=(2, pixels)), random.normal(size=pixels)
    weight = random.uniform(0.5, 2.0, pixels)
    by_levels = scipy.sparse.csr_matrix(
        scipy.sparse.random_array((pixels, 2), density=0.5, rng=random)
    )
    shared = _SharedUnknowns(
        random.normal(size=(pixels, 3)),
        by_levels,
        np.array([0.0, 4.0, 20.0, 3.0, 5.0]),
        random.normal(size=5),
    )
    shift, whitening = _displacements(by_px, patch, patches, residual, weight, shared)
    rows = np.zeros((pixels, 2 * patches))
    for axis in (0, 1):
        rows[np.arange(pixels), 2 * patch + axis] = by_px[axis]
    every = np.concatenate([rows, shared.rows, by_levels.toarray()], axis=1)
    normal = (every.T * weight) @ every
    normal[-5:, -5:] += np.diag(shared.prior)
    gradient = (every.T * weight) @ residual
    gradient[-5:] += shared.prior_gradient
    np.testing.assert_allclose(shift.ravel(), -np.linalg.solve(normal, gradient)[:-5])
    np.testing.assert_allclose(
        np.linalg.inv(whitening.T @ whitening), np.linalg.inv(normal)[:-5, :-5]
    )


@pytest.mark.parametrize("inflation", [1.0, 4.0])
@pytest.mark.parametrize("local", [False, True])
def test_what_is_known_beforehand_counts_less_as_pixels_that_share_noise_do(
    inflation: float, local: bool
) -> None:
    scene, point = lit_scene(local)
    count = point.state.unknowns.size
    shared = _shared_unknowns(scene, point, np.eye(count, 15), inflation)
    prior = point.state.unknowns.prior(TUNING.photometric, local=local)
    weight = np.asarray(prior.weight)
    assert weight.any()
    np.testing.assert_allclose(inflation * shared.prior[:count], weight)
    np.testing.assert_allclose(
        inflation * shared.prior_gradient[:count], weight * (point.state.values - prior.mean)
    )
    of_levels = np.asarray(point.state.levels).T.ravel() if local else np.zeros(0)
    width = np.tile(TUNING.photometric.local_widths, len(of_levels) // LOCAL_TERMS)
    np.testing.assert_allclose(inflation * shared.prior[count:], width**-2)
    np.testing.assert_allclose(inflation * shared.prior_gradient[count:], of_levels / width**2)


def test_light_of_a_block_moves_its_own_pixels_as_its_slope_says() -> None:
    scene, point = lit_scene(True)
    assert scene.blocks is not None
    by_levels = _shared_unknowns(scene, point, np.eye(point.state.unknowns.size, 15), 1.0).by_levels
    step = np.random.default_rng(5).normal(size=(LOCAL_TERMS, scene.blocks.count))
    light_change = np.sum(
        step[:, scene.blocks.of_pixel].reshape(2, 3, -1) * scene.blocks.basis.T, axis=1
    )
    by_local = point.rows_by_local(scene)
    np.testing.assert_allclose(by_levels @ step.T.ravel(), np.sum(by_local * light_change, axis=0))


def lit_scene(local: bool) -> tuple[PixelScene, ImageFitState]:
    """Fifteen pixels of three blocks, three of which are cut, and any derivatives."""
    random = np.random.default_rng(4)
    state = full_state(state_at(RIGHT), TUNING.photometric)
    levels = random.normal(size=(LOCAL_TERMS, 3)) if local else np.zeros((LOCAL_TERMS, 0))
    state = ImageState(state.pose, state.values, levels, state.unknowns)
    basis = np.column_stack([np.ones(15), random.normal(size=(15, 2))])
    nothing: Any = None
    rows = [PixelRows(nothing, nothing, random.normal(size=(1, 2, count))) for count in (10, 5)]
    point = ImageFitState(
        state,
        np.ones(4 + state.unknowns.size, dtype=bool),
        Prediction(rows[0], rows[1], nothing),
        *(np.ones(15), np.ones(15)),
        inliers=np.arange(15) > 2,
    )
    blocks = Blocks(np.arange(15) % 3, basis, 3)
    scene = PixelScene(
        *(nothing, (10, 5), nothing, nothing, nothing, nothing, nothing, nothing),
        PoseModel.AIMED,
        nothing,
        np.inf,
        TUNING.photometric,
        blocks=blocks,
        has_local_light=local,
    )
    return scene, point


def test_a_patch_of_next_to_no_information_is_none() -> None:
    label, information = np.array([4, 4, 7, 7, 9]), np.array([1.0, 2.0, 1e-6, 1e-6, 0.5])
    number, counted = _renumber_patches(label, information)
    assert number[[0, 1, 4]].tolist() == [0, 0, 1]
    np.testing.assert_array_equal(counted, [1.0, 2.0, 0.0, 0.0, 0.5])
