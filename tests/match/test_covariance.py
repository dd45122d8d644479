"""The scatter of many noisy matchings across the lines agrees with their covariances."""

import numpy as np

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.match.matcher import match_segments


def test_errors_across_the_lines_have_the_stated_covariance() -> None:
    rig, lines = rig_of("upper", "left", "right"), loose_lines(20, seed=21)
    squares = []
    for seed in range(12):
        matches = match_segments(pictures(rig, lines, sigma_px=0.4, seed=seed), rig, sigma_px=0.4)
        right = (matches.index == matches.index[:, :1]).all(axis=1)
        for row in np.flatnonzero(right):
            truth = lines[matches.index[row, 0]]
            along = truth[1] - truth[0]
            along /= np.linalg.norm(along)
            across = np.linalg.svd(along[None])[2][1:]
            for end in range(2):
                error = across @ (matches.lines_mm[row, end] - truth[0])
                block = matches.covariance_mm2[row, 3 * end : 3 * end + 3, 3 * end : 3 * end + 3]
                squares.append(error @ np.linalg.solve(across @ block @ across.T, error))
    squares = np.array(squares)
    assert len(squares) > 400
    # Two degrees of freedom each; ends of one line are independent.
    assert abs(squares.mean() - 2) < 4 * 2 / np.sqrt(len(squares))
    assert abs((squares < 5.991).mean() - 0.95) < 0.03
