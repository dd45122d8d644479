"""Errors that several lines share enter their joint covariance and that of derived quantities."""

import numpy as np
import pytest

from trinoc.geometry.uncertain_lines import UncertainLines, distance_mm


@pytest.fixture
def lines() -> UncertainLines:
    random = np.random.default_rng(0)
    root, shared = random.normal(size=(3, 6, 6)), random.normal(size=(4, 4))
    return UncertainLines(
        random.normal(size=(3, 2, 3)) + np.array([[0.0, 0, 0], [50.0, 0, 0]]),
        root @ np.swapaxes(root, 1, 2),
        random.normal(size=(3, 6, 4)),
        shared @ shared.T,
    )


def test_the_covariance_together_is_own_parts_and_one_of_the_cameras(lines) -> None:
    rows = [2, 0]
    by = np.concatenate([lines.by_parameters[k] for k in rows])
    expected = by @ lines.parameter_covariance @ by.T
    expected[:6, :6] += lines.fragment_covariance_mm2[2]
    expected[6:, 6:] += lines.fragment_covariance_mm2[0]
    np.testing.assert_allclose(lines.joint_covariance_mm2(rows), expected)
    np.testing.assert_allclose(lines.covariance_mm2[2], expected[:6, :6])


def test_a_motion_that_all_lines_share_leaves_their_distance_as_it_is(lines) -> None:
    """The only error of the cameras shifts all ends by the same vector."""
    shift = np.tile(np.eye(3), (2, 1))
    moved = UncertainLines(
        lines.ends_mm,
        1e-6 * lines.fragment_covariance_mm2,
        np.stack([shift] * 3),
        100.0 * np.eye(3),
    )
    assert moved.measure(distance_mm, 0, 1).sigma < 0.1
    assert moved.measure(lambda first: first[0, 0], 0).sigma == pytest.approx(10.0, rel=1e-3)
