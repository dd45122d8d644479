"""The standard deviation of an end along its line follows from contrast and partner."""

import numpy as np

from trinoc.segments.nevatia_babu.endpoints import (
    Pieces,
    end_sigmas,
    lines_near_ends,
    snap_ends,
)
from trinoc.segments.tuning import DEFAULT

SNAP_PX, SIGMA_PX = DEFAULT.ends.snap_px, DEFAULT.ends.sigma_free_px


def sigmas(gap_px: float, contrast: float) -> np.ndarray:
    """End sigmas of a line along u whose second end is `gap_px` away from a line along v."""
    centre = np.array([[50.0, 50.0], [80.0 + gap_px, 50.0]])
    direction = np.array([[1.0, 0.0], [0.0, 1.0]])
    extent = np.array([[-30.0, 30.0], [-40.0, 40.0]])
    pieces = Pieces(centre, direction, extent)
    nearby_lines = lines_near_ends(pieces, SNAP_PX)
    partner, _ = snap_ends(pieces, SNAP_PX, nearby_lines)
    return end_sigmas(np.full(2, contrast), partner)[0]


def test_an_end_at_a_crossing_is_well_known() -> None:
    assert sigmas(3.0, 50.0)[1] == DEFAULT.ends.sigma_crossing_px


def test_a_faint_edge_goes_on_unseen_farther_up_to_a_limit() -> None:
    free = np.array([sigmas(30.0, contrast)[1] for contrast in (200.0, 100.0, 50.0, 30.0, 5.0)])
    assert (np.diff(free) > 0).all()
    np.testing.assert_allclose(free[:4] * np.sqrt([200.0, 100.0, 50.0, 30.0]), SIGMA_PX)
    assert free[-1] == DEFAULT.ends.most_free_px
