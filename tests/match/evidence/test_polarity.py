"""Darker sides: the likelihood sums over both polarities of a line and over unknown signs."""

from itertools import product

import numpy as np

from trinoc.match.evidence.side_intensity import polarity_evidence
from trinoc.match.tuning.every_group import DEFAULT

TURNED = DEFAULT.evidence.reversed_share


# All ways that three members can be dark, on the right, on the left, or not known.
SIGNS = np.array(list(product((1.0, -1.0, 0.0), repeat=3)))
INDEX = np.repeat(np.arange(len(SIGNS))[:, None], 3, axis=1)
FORWARD = np.tile([0.2, 0.9], (len(SIGNS), 3, 1))


def by_enumeration(signs: np.ndarray) -> float:
    """Log evidence: a line has one dark side and some wrong signs; strangers have random signs."""
    known_signs = signs[signs != 0]
    as_one = sum(
        0.5 * np.prod(np.where(known_signs == dark, 1 - TURNED, TURNED)) for dark in (1, -1)
    )
    return float(np.log(as_one / 0.5 ** len(known_signs)))


def test_evidence_is_the_sum_over_both_sides_of_the_line() -> None:
    expected = [by_enumeration(signs) for signs in SIGNS]
    np.testing.assert_allclose(polarity_evidence(SIGNS.T, INDEX, FORWARD), expected, atol=1e-12)


def test_a_likelihood_ratio_is_one_on_average_over_strangers() -> None:
    has_all_signs = (SIGNS != 0).all(axis=1)
    ratio = np.exp(polarity_evidence(SIGNS.T, INDEX, FORWARD)[has_all_signs])
    np.testing.assert_allclose(ratio.mean(), 1.0)


def test_which_end_comes_first_means_nothing() -> None:
    expected = polarity_evidence(SIGNS.T, INDEX, FORWARD)
    turned, against = SIGNS.copy(), FORWARD.copy()
    turned[:, 1] *= -1
    against[:, 1] = against[:, 1, ::-1]
    np.testing.assert_allclose(polarity_evidence(turned.T, INDEX, against), expected, atol=1e-12)
    backward = FORWARD[:, :, ::-1]
    np.testing.assert_allclose(polarity_evidence(SIGNS.T, INDEX, backward), expected, atol=1e-12)


def test_members_that_are_missing_or_not_known_say_nothing() -> None:
    without = INDEX.copy()
    without[:, 2] = -1
    unknown = SIGNS.copy()
    unknown[:, 2] = 0
    np.testing.assert_array_equal(
        polarity_evidence(SIGNS.T, without, FORWARD), polarity_evidence(unknown.T, INDEX, FORWARD)
    )
    one = SIGNS * [1, 0, 0]
    np.testing.assert_allclose(polarity_evidence(one.T, INDEX, FORWARD), 0, atol=1e-12)
