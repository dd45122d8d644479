"""Density of line positions, learned from the other lines."""

import numpy as np
import pytest

from trinoc.match.evidence.mixture import fit_volume
from trinoc.match.occlusion.pairs_alone import log_position_density_among
from trinoc.match.tuning.every_group import DEFAULT

COUNT = 4000


def strewn(seed: int) -> np.ndarray:
    """Short lines, uniform in a box of 80 x 60 x 20 mm."""
    generator = np.random.default_rng(seed)
    first = generator.uniform([-40, -30, 0], [40, 30, 20], (COUNT, 3))
    return np.stack([first, first + generator.normal(0, 0.1, (COUNT, 3))], axis=1)


def placed(ends_mm: np.ndarray, posterior: np.ndarray) -> np.ndarray:
    volume = fit_volume(ends_mm, posterior)
    return log_position_density_among(ends_mm, posterior, volume, DEFAULT)


def test_in_an_even_box_the_density_is_that_of_the_box() -> None:
    log_density = placed(strewn(0), np.ones(COUNT))
    even = -np.log(80 * 60 * 20 * 2 * np.pi)
    assert np.median(log_density) == pytest.approx(even, abs=0.1)


def test_a_line_alone_says_nothing_of_where_lines_are() -> None:
    ends = strewn(1)
    ends[0] += [0, 0, 40]  # beyond what the others reach
    posterior = np.ones(COUNT)
    log_density, doubted = placed(ends, posterior), placed(ends, np.append(1e-6, posterior[1:]))
    assert log_density[0] < np.median(log_density) - 5
    assert log_density[0] == pytest.approx(doubted[0], abs=0.1)


def test_density_goes_with_the_scene_as_it_moves_turns_and_grows() -> None:
    ends, generator = strewn(2), np.random.default_rng(3)
    posterior = generator.uniform(0, 1, COUNT)
    turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    moved = 3.0 * ends @ turn.T + [100.0, -50.0, 700.0]
    change = placed(moved, posterior) - placed(ends, posterior)
    # An axis may point either way, which moves lines on the border of two bins.
    assert np.quantile(np.abs(change + 3 * np.log(3.0)), 0.99) < 0.05


def test_frames_of_a_stack_are_profiled_each_for_itself() -> None:
    ends, posterior = strewn(4), np.full(COUNT, 0.7)
    frame = np.arange(COUNT) % 2
    ends[frame == 1] *= 5.0
    volume = fit_volume(ends, posterior, frame=frame, frames=2)
    both = log_position_density_among(ends, posterior, volume, DEFAULT, frame)
    for number in range(2):
        in_frame = frame == number
        np.testing.assert_allclose(
            both[in_frame], placed(ends[in_frame], posterior[in_frame]), atol=1e-9
        )
