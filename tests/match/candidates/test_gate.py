"""The gate and the table of cells agree with a search through all segments of the third view."""

from typing import NamedTuple

import jax
import numpy as np
import pytest

from tests.match.scene import MadeScene
from trinoc.match.candidates.index import (
    SAMPLES,
    find_segments_near_predictions,
    index_segments,
    keys_of_prediction,
)
from trinoc.match.candidates.search import passes_third_view_gate
from trinoc.match.candidates.third_view import Prediction, predict, third_view
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.two_view.epipolar_pencil import build_pencil, take_segments

ONE_SAMPLE_PX = DEFAULT.candidates.one_sample_px
REACH = DEFAULT.candidates.search_sigmas
GATE = DEFAULT.candidates.gate
SMALLEST_OVERLAP = DEFAULT.candidates.smallest_overlap

# The views left and right, which cross best, predict the view from above.
FIRST, SECOND, THIRD = 0, 1, 2
COUNT = 30


class Dense(NamedTuple):
    """Predictions of all pairs p and all segments k: arrays (p, k), or (p,) for pairs alone."""

    predictions: Prediction
    keys: np.ndarray
    passes: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    chi_square: np.ndarray
    ends_px: np.ndarray


@jax.jit
def predicted_and_gated(lines, grid, ends_px, line):
    planes = build_pencil(lines, np.array(FIRST), np.array(SECOND))
    view = third_view(lines, planes, np.array(THIRD))

    def one(i, j):
        guess = predict(view, take_segments(planes.first, i), take_segments(planes.second, j))
        gate = jax.vmap(lambda *k: passes_third_view_gate(guess, *k))
        return (
            guess,
            keys_of_prediction(grid, guess),
            gate(ends_px, line, lines.across_px2[THIRD, :COUNT]),
        )

    i, j = np.divmod(np.arange(COUNT * COUNT), COUNT)
    return jax.vmap(one)(i, j)


@pytest.fixture(scope="module")
def table(noisy: MadeScene):
    return index_segments(noisy.inputs.lines, THIRD, COUNT)


@pytest.fixture(scope="module")
def dense(noisy: MadeScene, table) -> Dense:
    lines = noisy.table
    ends, line = lines.ends_px[THIRD, :COUNT], lines.line[THIRD, :COUNT]
    prediction_of_all = predicted_and_gated(noisy.inputs.lines, table.grid, ends, line)
    guess, keys, passes = jax.tree.map(np.asarray, prediction_of_all)
    predicted_px = np.stack([guess.u0, guess.v0, guess.u1, guess.v1], axis=1).reshape(-1, 1, 2, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        step = predicted_px[:, :, 1] - predicted_px[:, :, 0]
        share = ((ends - predicted_px[:, :, :1]) * step[:, :, None]).sum(-1)
        share = share / (step**2).sum(-1)[..., None]
        begin = np.maximum(share.min(axis=2), 0.0)
        end = np.minimum(share.max(axis=2), 1.0)
        chi_square = misfit(
            guess, predicted_px, share, begin, end, line, lines.across_px2[THIRD, :COUNT]
        )
        shorter = np.minimum(1.0, np.ptp(share, axis=2))
    overlaps = end - begin > SMALLEST_OVERLAP * shorter
    chi_square = np.where(overlaps & guess.possible[:, None], chi_square, np.inf)
    return Dense(guess, np.stack(keys), passes, begin, end, chi_square, predicted_px[:, 0])


def misfit(guess, predicted_px, share, begin, end, line, across_px2) -> np.ndarray:
    """Chi-square of two points of the segment's line, errors interpolated by plain matrices."""

    def weights(fraction: np.ndarray) -> np.ndarray:
        return np.stack([1 - fraction, fraction], axis=-1)

    common = np.stack([begin, end], axis=-1)
    on_prediction = weights(common)
    on_segment = weights((common - share[..., :1]) / (share[..., 1:] - share[..., :1]))
    off = (predicted_px * line[:, None, :2]).sum(-1) + line[:, None, 2]
    residual = (on_prediction @ off[..., None])[..., 0]
    prediction_covariance = np.stack([guess.c00, guess.c01, guess.c01, guess.c11], axis=1).reshape(
        -1, 1, 2, 2
    )
    covariance = (
        on_prediction @ prediction_covariance @ on_prediction.mT
        + on_segment @ across_px2 @ on_segment.mT
    )
    determinant = np.linalg.det(covariance)
    a, b, c = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return (
        c * residual[..., 0] ** 2
        - 2 * b * residual[..., 0] * residual[..., 1]
        + a * residual[..., 1] ** 2
    ) / determinant


def test_the_gate_is_a_chi_square_on_the_common_part(dense: Dense) -> None:
    clear = np.abs(dense.chi_square / (1.1 * GATE) - 1) > 1e-6
    assert dense.passes.sum() > 30
    np.testing.assert_array_equal(dense.passes[clear], (dense.chi_square < 1.1 * GATE)[clear])


def test_which_end_of_a_segment_comes_first_means_nothing(
    noisy: MadeScene, table, dense: Dense
) -> None:
    lines = noisy.table
    ends, line = lines.ends_px[THIRD, :COUNT, ::-1], -lines.line[THIRD, :COUNT]
    # Both ends of each have one variance, and no correlation.
    passes = predicted_and_gated(noisy.inputs.lines, table.grid, np.ascontiguousarray(ends), line)[
        2
    ]
    np.testing.assert_array_equal(np.asarray(passes), dense.passes)


def test_true_partners_pass(noisy: MadeScene, dense: Dense) -> None:
    pair = noisy.true[:, FIRST] * COUNT + noisy.true[:, SECOND]
    is_possible = dense.predictions.possible[pair]
    assert is_possible.sum() >= 20
    assert dense.passes[pair, noisy.true[:, THIRD]][is_possible].all()


def test_the_table_finds_what_is_near_and_nearly_parallel_at_a_sample(
    noisy: MadeScene, table, dense: Dense
) -> None:
    in_table = np.zeros_like(dense.passes)
    in_table[find_segments_near_predictions(table, dense.keys)] = True
    guess, lines = dense.predictions, noisy.table
    step = dense.ends_px[:, 1] - dense.ends_px[:, 0]
    length = np.linalg.norm(step, axis=1)
    line, segment_length = lines.line[THIRD, :COUNT], lines.length_px[THIRD, :COUNT]
    sigma = np.sqrt(lines.across_px2[THIRD, :COUNT, [0, 1], [0, 1]].max(axis=0))
    is_near = np.zeros_like(in_table)
    for number, sample in enumerate(SAMPLES):
        point = dense.ends_px[:, 0] + sample * step
        off = np.abs(point @ line[:, :2].T + line[:, 2])
        reach = REACH * np.hypot(np.sqrt(np.maximum(guess.c00, guess.c11))[:, None], sigma)
        covered = (dense.begin <= sample) & (sample <= dense.end) & (off < reach)
        covered &= ((point >= 0) & (point < lines.size_px[THIRD])).all(axis=1)[:, None]
        is_near |= covered & ((number == 0) | (length > ONE_SAMPLE_PX))[:, None]
    sine = np.abs(step @ line[:, :2].T) / length[:, None]
    slack = np.sqrt(guess.c00 + guess.c11 - 2 * guess.c01) / length
    is_near &= np.arcsin(sine) < REACH * (slack[:, None] + np.sqrt(2) * sigma / segment_length)
    expected = dense.passes & is_near
    assert in_table[expected].all()
    # So are partners: the gate alone would let segments pass that cross the prediction.
    pair = noisy.true[:, FIRST] * COUNT + noisy.true[:, SECOND]
    is_possible = guess.possible[pair]
    assert expected[pair, noisy.true[:, THIRD]][is_possible].mean() > 0.9
    assert in_table[pair, noisy.true[:, THIRD]][is_possible].all()
