"""Simulated segments lie on the images of their edges and have the requested errors."""

import numpy as np
import pytest

from simulation import Detector, loose_segments, simulate_segments
from simulation.observations import PERFECT
from simulation.scenes import demo_scene
from trinoc.synth import table1_rig
from trinoc.synth.truth import NOT_SCORED, SPURIOUS, points_along

RIG = table1_rig()
SCENE = loose_segments(5, count=300)


def images(name, truth, chosen):
    ends = points_along(truth.edges_mm[truth.edge_of[name][chosen]], truth.extent[name][chosen])
    image = ends @ RIG[name].matrix_px[:, :3].T + RIG[name].matrix_px[:, 3]
    return image[..., :2] / image[..., 2:]


def offsets(estimated, true_ends):
    """Offsets of each end from its true end, in the order of ends that fits better."""
    straight, turned = estimated - true_ends, estimated[:, ::-1] - true_ends
    fits = np.abs(straight).sum(axis=(1, 2)) < np.abs(turned).sum(axis=(1, 2))
    return np.where(fits[:, None, None], straight, turned)


def test_a_perfect_detector_gives_the_images_of_what_is_seen():
    segments, truth = simulate_segments(demo_scene(cylinder_sides=12), RIG, PERFECT, seed=1)
    for name in RIG:
        real = truth.edge_of[name] >= 0
        ends = np.asarray(segments[name].endpoints_px)[real]
        np.testing.assert_allclose(offsets(ends, images(name, truth, real)), 0.0, atol=1e-6)
        assert np.sum(truth.edge_of[name] == NOT_SCORED) == 2
        assert not np.any(truth.edge_of[name] == SPURIOUS)


def test_end_points_scatter_by_their_sigma():
    detector = Detector(0.5, 0.0, 0.0, 0.0, 0.0, 8.0)
    segments, truth = simulate_segments(SCENE, RIG, detector, seed=2)
    errors = np.concatenate(
        [
            offsets(
                np.asarray(segments[name].endpoints_px),
                images(name, truth, np.full(len(segments[name]), True)),
            ).ravel()
            for name in RIG
        ]
    )
    assert errors.std() == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(2 * len(errors)))


def test_shares_are_those_asked_for():
    complete, _ = simulate_segments(SCENE, RIG, PERFECT, seed=3)
    count = sum(len(complete[name]) for name in RIG)
    missing, _ = simulate_segments(SCENE, RIG, Detector(0.0, 0.0, 0.0, 0.3, 0.0, 0.0), seed=3)
    # Of three views one misses the edge: a share of 0.3 takes a tenth of all segments.
    lost = 1 - sum(len(missing[name]) for name in RIG) / count
    assert lost == pytest.approx(0.1, abs=5 * np.sqrt(0.3 * 0.7 / 300) / 3)
    spurious, truth = simulate_segments(SCENE, RIG, Detector(0.0, 0.0, 0.25, 0.0, 0.0, 0.0), seed=3)
    for name in RIG:
        strays = int(np.sum(truth.edge_of[name] == SPURIOUS))
        assert strays == round(0.25 * (len(spurious[name]) - strays))
    broken, truth = simulate_segments(SCENE, RIG, Detector(0.0, 1.0, 0.0, 0.0, 0.0, 0.0), seed=3)
    assert 2 * count <= sum(len(broken[name]) for name in RIG) <= 3 * count


def test_ends_are_cut_back_and_never_beyond():
    detector = Detector(0.0, 0.0, 0.0, 0.0, 5.0, 0.0)
    segments, _ = simulate_segments(SCENE, RIG, detector, seed=4)
    complete, _ = simulate_segments(SCENE, RIG, PERFECT, seed=4)
    for name in RIG:
        total = np.sum(complete[name].length_px) - np.sum(segments[name].length_px)
        assert 0 < total / len(complete[name]) < 10


def test_observations_repeat_by_seed():
    first, repeated, other = (
        simulate_segments(SCENE, RIG, Detector(), seed=s)[0] for s in (6, 6, 7)
    )
    for name in RIG:
        np.testing.assert_array_equal(first[name].endpoints_px, repeated[name].endpoints_px)
    assert len(first["left"]) != len(other["left"]) or not np.array_equal(
        first["left"].endpoints_px, other["left"].endpoints_px
    )


def test_segments_state_the_sigma_that_they_were_drawn_with() -> None:
    segments_by_view, _ = simulate_segments(SCENE, RIG, Detector(end_sigma_px=0.7), seed=2)
    for segments in segments_by_view.values():
        ends = np.asarray(segments.endpoints_px)
        directions = ends[:, 1] - ends[:, 0]
        normal = (
            np.stack([-directions[:, 1], directions[:, 0]], axis=1)
            / np.linalg.norm(directions, axis=1)[:, None]
        )
        blocks = np.asarray(segments.covariance_px2).reshape(-1, 2, 2, 2, 2)
        across = np.einsum("ni,neiej,nj->ne", normal, blocks, normal)
        np.testing.assert_allclose(across, 0.7**2, rtol=1e-6)
