"""Number of crossings of segments: solid bodies hide lines behind them."""

import numpy as np
import pytest

from simulation import Detector, block_scene, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc.match.occlusion.solids import crossings, see_through_share
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.synth import table1_rig

COUNT = 300
PERFECT = Detector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def strewn(seed: int, count: int = COUNT) -> np.ndarray:
    """Random segments of 5 to 80 px, in all positions and directions."""
    generator = np.random.default_rng(seed)
    middle = generator.uniform(0, 500, (count, 1, 2))
    angle, half = generator.uniform(0, np.pi, count), generator.uniform(2.5, 40, count)
    step = (half * [np.cos(angle), np.sin(angle)]).T[:, None]
    return np.concatenate([middle - step, middle + step], axis=1)


def test_segments_that_lie_by_chance_cross_as_often_as_expected() -> None:
    crossed_and_expected = np.array(
        [crossings(strewn(seed), np.ones(COUNT), 3.0) for seed in range(20)]
    )
    crossed, expected = crossed_and_expected.sum(axis=0)
    # The number is about Poisson's: four standard deviations.
    assert abs(crossed - expected) < 4 * np.sqrt(expected) + 0.02 * expected


def test_both_counts_stay_as_the_picture_turns_and_its_segments_change_places() -> None:
    ends, generator = strewn(30), np.random.default_rng(31)
    weight, order = generator.uniform(0, 1, COUNT), generator.permutation(COUNT)
    cosine, sine = np.cos(0.7), np.sin(0.7)
    turned = ends[order, ::-1] @ np.array([[cosine, -sine], [sine, cosine]]) + [900.0, -40.0]
    assert crossings(turned, weight[order], 3.0) == pytest.approx(crossings(ends, weight, 3.0))


def test_both_counts_go_with_the_square_of_the_weight() -> None:
    ends = strewn(32)
    once, half = (crossings(ends, np.full(COUNT, weight), 3.0) for weight in (1.0, 0.5))
    assert np.array(once) == pytest.approx(4 * np.array(half))


@pytest.mark.parametrize("stop_px", [-2.0, 2.0])
def test_a_segment_that_stops_at_another_does_not_cross_it(stop_px: float) -> None:
    ends = np.array([[[0.0, 0], [100, 0]], [[40, 60], [50, stop_px]]])
    assert crossings(ends, np.ones(2), 3.0)[0] == 0.0
    assert crossings(ends - [[[0, 0]], [[0, 20]]], np.ones(2), 3.0)[0] == 1.0


def test_nothing_is_no_crossing() -> None:
    assert crossings(np.zeros((0, 2, 2)), np.zeros(0), 3.0) == (0.0, 0.0)


def test_see_through_boxes_and_blocks_differ_each_frame_for_itself() -> None:
    ends, index, frame, start = [], [], [], 0
    for number, scene in enumerate((see_through_boxes(3, count=12), block_scene(3, count=8))):
        segments, _ = simulate_segments(scene, table1_rig(), PERFECT, seed=3)
        ends.append(np.asarray(segments["left"].endpoints_px))
        index.append(start + np.arange(len(ends[-1])))
        frame.append(np.full(len(ends[-1]), number))
        start += len(ends[-1])
    table, rows = np.concatenate(ends)[None], np.concatenate(index)[:, None]
    owner, sure = np.concatenate(frame), np.ones(start)
    boxes, blocks = see_through_share(table, rows, sure, DEFAULT, owner, 2)
    assert boxes > 0.6
    assert blocks < 0.1
    alone = see_through_share(table, rows[owner == 1], sure[owner == 1], DEFAULT)
    assert alone == pytest.approx([blocks])


def test_without_a_matched_segment_nothing_is_seen_through() -> None:
    none = np.zeros((0, 2), dtype=np.int64)
    share = see_through_share(np.zeros((2, 4, 2, 2)), none, np.zeros(0), DEFAULT)
    assert share == pytest.approx([0.0])
