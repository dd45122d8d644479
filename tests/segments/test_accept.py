"""What counts against a line is weighed by what the picture's other lines are like."""

import numpy as np

from trinoc.segments.nevatia_babu.accept import is_sharp, is_straight
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.tuning import DEFAULT


def lines(
    blur_px2, *, support: int = 40, sagitta_px: float = 0.0, residual_px: float = 0.05
) -> FittedLines:
    """Clear lines far from each other, so many points long."""
    blur = np.asarray(blur_px2, dtype=float)
    one = np.ones(len(blur))
    centre = np.stack([np.arange(len(blur)) * 500.0, 0 * one], axis=-1)
    way = np.tile([1.0, 0.0], (len(blur), 1))
    return FittedLines(
        centre, way, support / 2 * np.stack([-one, one], axis=-1), 40 * one, one, blur, 1.5 * one,
        1e-4 * one, residual_px * one, sagitta_px * one, np.full(len(blur), support),
        1e4 * support * one,
    )  # fmt: skip


def test_a_wide_edge_among_edges_of_one_width_is_a_shadow() -> None:
    alike = np.append(np.full(20, 1.0), 4.5)
    assert is_sharp(lines(alike), 1.0).tolist() == [True] * 20 + [False]


def test_a_narrow_edge_is_no_shadow_however_sharp_the_others() -> None:
    limit = DEFAULT.accept.sharp_px2
    sharp = np.append(np.full(20, 0.1), [0.99 * limit, 1.01 * limit])
    assert is_sharp(lines(sharp), 0.1).tolist() == [True] * 21 + [False]


def test_a_line_that_bows_as_its_points_lie_is_an_arc() -> None:
    # A parabola of this bow leaves its best line by this root mean square distance.
    bow, rms = 0.9, 0.9 * np.sqrt(4 / 45)
    arc = lines([1.0], sagitta_px=bow, residual_px=rms, support=24)
    ragged = lines([1.0], sagitta_px=bow, residual_px=2 * rms, support=24)
    assert not is_straight(arc, 512)[0]
    assert is_straight(ragged, 512)[0]
    # One that bows as much for a length less than its bow allows.
    short = lines([1.0], sagitta_px=bow, residual_px=2 * rms, support=20)
    assert not is_straight(short, 512)[0]
