"""The posterior rises with right triples only, so that it ranks rounds of matching."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trinoc.calib.bundle.estimate import log_posterior
from trinoc.numerics.robust_loss import GemanMcClure

LOSS = GemanMcClure.from_scale(4.0)


def tracks(seed, count, views=3):
    random = np.random.default_rng(seed)
    return random.chisquare(2, (count, views)) * (views - 2) / views, np.ones((count, views), bool)


def test_two_views_gain_nothing():
    squared, visible = tracks(0, 20)
    more = np.concatenate([squared, np.zeros((50, 3))])
    more_visible = np.concatenate([visible, np.tile([True, False, True], (50, 1))])
    value = log_posterior(squared, visible, 3.0, LOSS)
    assert log_posterior(more, more_visible, 3.0, LOSS) == pytest.approx(value)


def test_right_triples_gain_and_wrong_ones_do_not():
    squared, visible = tracks(1, 20)
    value = log_posterior(squared, visible, 3.0, LOSS)
    right, _ = tracks(2, 5)
    with_right = np.concatenate([squared, right])
    assert (
        log_posterior(with_right, np.ones((25, 3), bool), 3.0, LOSS) > value + 5 * LOSS.ceiling / 4
    )
    wrong = np.tile([0.0, 1e4, 1e4], (5, 1))
    with_wrong = np.concatenate([squared, wrong])
    assert log_posterior(with_wrong, np.ones((25, 3), bool), 3.0, LOSS) == pytest.approx(value)


@given(st.integers(0, 1000), st.integers(3, 5), st.floats(0, 100))
def test_order_does_not_matter_and_the_sheet_counts_in_full(seed, views, sheet):
    squared, visible = tracks(seed, 12, views)
    random = np.random.default_rng(seed)
    visible[random.random(visible.shape) < 0.2] = False
    value = log_posterior(squared, visible, sheet, LOSS)
    rows, columns = random.permutation(12), random.permutation(views)
    turned = log_posterior(squared[rows][:, columns], visible[rows][:, columns], sheet, LOSS)
    assert turned == pytest.approx(value)
    assert value == pytest.approx(log_posterior(squared, visible, 0.0, LOSS) - sheet / 2)


@given(st.integers(0, 1000), st.floats(1, 30))
def test_a_larger_distance_never_gains(seed, factor):
    squared, visible = tracks(seed, 12)
    assert log_posterior(factor * squared, visible, 0, LOSS) <= log_posterior(
        squared, visible, 0, LOSS
    )
