"""What an end's standard deviation along its line follows from."""

import numpy as np

from trinoc.segments.nevatia_babu.endpoints import (
    Pieces,
    end_sigmas,
    lines_near_ends,
    snap_ends,
)
from trinoc.segments.tuning import DEFAULT

SNAP_PX = DEFAULT.ends.snap_px


def sigmas(gap_px: float, contrast: float) -> np.ndarray:
    """Of a line along u, whose second end is so far before a line along v."""
    centre = np.array([[50.0, 50.0], [80.0 + gap_px, 50.0]])
    direction = np.array([[1.0, 0.0], [0.0, 1.0]])
    extent = np.array([[-30.0, 30.0], [-40.0, 40.0]])
    pieces = Pieces(centre, direction, extent)
    near = lines_near_ends(pieces, SNAP_PX)
    partner, _ = snap_ends(pieces, SNAP_PX, near)
    return end_sigmas(pieces, np.full(2, contrast), partner, near)[0]


def test_an_end_at_a_crossing_is_well_known() -> None:
    assert sigmas(3.0, 50.0)[1] == DEFAULT.ends.sigma_crossing_px


def test_an_end_short_of_the_next_crossing_may_go_on_to_it() -> None:
    assert np.isclose(sigmas(6.5, 50.0)[1], 6.5)
    assert np.isclose(sigmas(30.0, 50.0)[1], DEFAULT.ends.sigma_free_px / np.sqrt(50.0))


def test_a_faint_edge_goes_on_unseen_farther_within_limits() -> None:
    free = np.array([sigmas(30.0, contrast)[0] for contrast in (1e4, 100.0, 50.0, 30.0, 5.0)])
    assert (np.diff(free) > 0).all()
    assert free[0] == DEFAULT.ends.least_free_px
    assert free[-1] == DEFAULT.ends.most_free_px
