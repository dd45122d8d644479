"""Tables of segments: selecting rows and appending tables."""

import dataclasses

import cv2
import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.geometry.segments import Segments, as_endpoints, covariance_of_ends


def some(count: int, seed: int) -> Segments:
    """Random segments with all columns except the junctions."""
    random = np.random.default_rng(seed)
    plain = Segments.from_endpoints(random.uniform(0, 500, (count, 4)), image_size_px=(512, 480))
    return dataclasses.replace(
        plain,
        contrast=random.uniform(5, 90, count),
        reasons=np.array(["", "bent"])[random.integers(0, 2, count)],
        chain=random.integers(0, 3, count),
        side_levels=random.uniform(0, 255, (count, 2)),
    )


def test_a_table_cut_in_two_and_joined_is_the_table():
    table = some(9, seed=0)
    joined = table.take(np.arange(4)).append(table.take(np.arange(4, 9)))
    for name in ("endpoints_px", "covariance_px2", "contrast", "support", "reasons", "side_levels"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(table, name), err_msg=name)


def test_what_follows_belongs_to_no_chain():
    first, second = some(5, seed=1), some(3, seed=2)
    chain = np.asarray(first.append(second).chain)
    np.testing.assert_array_equal(chain[:5], first.chain)
    assert len(set(chain[5:]) - set(chain[:5])) == 3


def test_what_one_table_does_not_know_is_not_made_up():
    complete, ends = some(4, seed=3), np.array([[1.0, 2.0, 30.0, 40.0]])
    plain = Segments.from_endpoints(ends)
    after = complete.append(plain)
    assert after.side_levels is not None
    assert after.reasons is not None
    assert np.isnan(after.side_levels[4]).all()
    assert after.reasons[4] == ""
    before = plain.append(complete)
    assert before.side_levels is None
    assert before.reasons is None
    assert before.chain is None


def test_arrays_of_opencv_s_detectors_are_taken_as_they_are():
    picture = np.full((200, 260), 60, np.uint8)
    cv2.rectangle(picture, (40, 50), (200, 140), 190, -1)
    by_lsd = cv2.createLineSegmentDetector().detect(picture)[0]
    by_hough = cv2.HoughLinesP(cv2.Canny(picture, 50, 150), 1, np.pi / 180, 30, minLineLength=30)
    for detected in (np.asarray(by_lsd), np.asarray(by_hough)):
        assert len(detected) >= 4
        # Most versions give (n, 1, 4), some (n, 4).
        flat = detected.reshape(-1, 4).astype(np.float64)
        rows = detected.reshape(-1, 1, 4)
        expected = Segments.from_endpoints(flat).endpoints_px
        np.testing.assert_array_equal(Segments.from_endpoints(rows).endpoints_px, expected)
        np.testing.assert_array_equal(as_endpoints(rows).reshape(-1, 4), flat)
    with pytest.raises(InputError, match=r"None.*np\.zeros\(\(0, 4\)\)"):
        Segments.from_endpoints(None)  # pyright: ignore[reportArgumentType]


def test_ends_err_by_their_sigmas_along_and_across():
    ends = np.array([[[10.0, 20.0], [70.0, 100.0]]])
    covariance = covariance_of_ends(ends, 0.5, 2.0)[0]
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    for block in (covariance[:2, :2], covariance[2:, 2:]):
        np.testing.assert_allclose(block @ along, 2.0**2 * along, rtol=1e-12)
        np.testing.assert_allclose(block @ across, 0.5**2 * across, rtol=1e-12)
    assert (covariance[:2, 2:] == 0).all()
