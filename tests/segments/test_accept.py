"""Evidence against a line is weighed by the properties of the picture's other lines."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trinoc.numerics.vectors import cross_2d
from trinoc.segments import find_segments
from trinoc.segments.nevatia_babu.accept import is_sharp, is_straight
from trinoc.segments.nevatia_babu.line_fit import FittedLines


def lines(
    blur_px2, *, support: int = 40, sagitta_px: float = 0.0, residual_px: float = 0.05
) -> FittedLines:
    """Clear lines far from each other, each of `support` points."""
    blur = np.asarray(blur_px2, dtype=float)
    one = np.ones(len(blur))
    centre = np.stack([np.arange(len(blur)) * 500.0, 0 * one], axis=-1)
    direction = np.tile([1.0, 0.0], (len(blur), 1))
    return FittedLines(
        centre, direction, support / 2 * np.stack([-one, one], axis=-1), 40 * one, one, blur,
        1.5 * one, 1e-4 * one, residual_px * one, sagitta_px * one, np.full(len(blur), support),
        1e4 * support * one,
    )  # fmt: skip


def test_a_wide_edge_among_edges_of_one_width_is_a_shadow() -> None:
    alike = np.append(np.full(20, 1.0), 4.5)
    assert is_sharp(lines(alike), 1.0).tolist() == [True] * 20 + [False]


MANY_WIDTHS = np.linspace(0.2, 4.0, 20)


def test_a_wide_edge_among_edges_of_many_widths_is_no_shadow() -> None:
    assert is_sharp(lines(np.append(MANY_WIDTHS, 4.5)), 2.0).all()
    assert not is_sharp(lines(np.append(MANY_WIDTHS, 40.0)), 2.0)[-1]


@settings(max_examples=20)
@given(wider=st.floats(1.0, 100.0))
def test_what_counts_as_wide_does_not_depend_on_how_wide_the_wider_half_is(wider: float) -> None:
    # Shadows are wider than edges: they must not widen the limit for each other.
    half = MANY_WIDTHS[MANY_WIDTHS > 2.0]
    with_shadows = np.concatenate([MANY_WIDTHS[MANY_WIDTHS <= 2.0], half * wider, [4.5]])
    assert is_sharp(lines(with_shadows), 2.0)[-1]


def test_widths_of_faint_lines_do_not_widen_the_limit() -> None:
    clear, faint = lines(np.append(np.full(20, 1.0), 4.5)), lines(MANY_WIDTHS)
    faint = faint._replace(snr2=20.0 * faint.support)
    both = FittedLines(*(np.concatenate(pair) for pair in zip(clear, faint, strict=True)))
    assert is_sharp(both, 1.0)[:21].tolist() == [True] * 20 + [False]


def pieces_of_a_circle(radius_px: float, angle_deg: float, count: int) -> FittedLines:
    """Consecutive chords of a circle, with the sagitta of their arcs."""
    angle = np.radians(angle_deg) * (np.arange(count) + 0.5)
    half, direction = np.radians(angle_deg) / 2, np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    bow, extent = radius_px * (1 - np.cos(half)), radius_px * np.sin(half)
    chords = lines(np.ones(count), sagitta_px=bow, residual_px=float(bow * np.sqrt(4 / 45)))
    middle = radius_px * np.cos(half) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    ends = np.tile([-extent, extent], (count, 1))
    # The bow's sign is that of the turn from each piece to the next.
    return chords._replace(centre_px=middle, direction=direction, extent_px=ends)


def test_pieces_that_go_on_as_they_bow_are_an_arc_and_one_piece_alone_is_none() -> None:
    arc = pieces_of_a_circle(40.0, 25.0, 6)
    assert not is_straight(arc).any()
    assert is_straight(FittedLines(*(field[:1] for field in arc))).all()


def test_points_that_scatter_more_than_the_arc_explains_lie_on_a_line() -> None:
    flat, round_ = pieces_of_a_circle(60.0, 15.0, 6), pieces_of_a_circle(40.0, 25.0, 6)
    assert not is_straight(flat).any()
    assert is_straight(flat._replace(residual_px=2 * flat.residual_px)).all()
    # Unless they bow much for their length.
    assert not is_straight(round_._replace(residual_px=2 * round_.residual_px)).any()


@pytest.mark.skipif("TRINOC_DATA" not in os.environ, reason="TRINOC_DATA names no folder of data")
@pytest.mark.parametrize(("name", "least_share"), [("vgg_corridor", 0.93), ("vgg_house", 0.94)])
def test_published_segments_of_photographs_are_found(name: str, least_share: float) -> None:
    folder = Path(os.environ["TRINOC_DATA"]) / name
    pictures = sorted(folder.glob("view*"))
    if not pictures:
        pytest.skip(f"TRINOC_DATA holds no {name}")
    published = np.load(next(folder.glob("*.npz")))["segments_0"][:, :4].reshape(-1, 2, 2)
    picture = np.asarray(cv2.imread(str(pictures[0]), cv2.IMREAD_GRAYSCALE))
    ends = find_segments(picture).endpoints_px
    direction = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(direction, axis=1)
    direction /= length[:, None]
    # Points along the published segments, about one per pixel.
    parts = [np.linspace(a, b, int(np.linalg.norm(b - a))) for a, b in published]
    offset = np.concatenate(parts)[:, None] - ends[:, 0]
    along, across = (offset * direction).sum(-1), np.abs(cross_2d(offset, direction))
    is_near = (across < 1.5) & (along > -1.5) & (along < length + 1.5)
    assert is_near.any(axis=1).mean() > least_share
