"""Fragments of segments: their covariance follows from that of the segments' ends."""

import numpy as np

from trinoc.match.tracks.line_fit import _part_covariance


def test_a_fragment_errs_as_the_means_of_its_segment_s_ends_that_it_is():
    random = np.random.default_rng(0)
    root = random.normal(size=(7, 4, 4))
    covariance, interval = root @ root.mT, random.uniform(0, 1, size=(7, 2))
    part_covariance = _part_covariance(covariance, interval).reshape(4, 4, 7)
    for row in range(7):
        share = interval[row]
        mean = np.kron(np.stack([1 - share, share], axis=1), np.eye(2))
        np.testing.assert_allclose(
            part_covariance[..., row], mean @ covariance[row] @ mean.T, rtol=1e-10
        )
