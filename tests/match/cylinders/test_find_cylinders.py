"""Cylinders by their outlines: exact ones, noisy ones, none, and the tracks that hold one."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from simulation.solids import box
from tests.match.cylinders.made_outlines import Placed, nothing_matched, seen_by
from tests.match.made import loose_lines, rig_of
from trinoc.errors import InputError
from trinoc.match import Cylinders, MatchTuning, find_cylinders
from trinoc.match.bodies import cylinder_search
from trinoc.match.matcher import match_segments
from trinoc.match.tuning.bodies import CylinderTuning
from trinoc.numerics.tables import with_field
from trinoc.numerics.vectors import complete_axes

VIEWS = ("upper", "left", "right")
UPRIGHT = Placed(12.0, 30.0, shift_mm=(20.0, -15.0, 0.0))
TILTED = Placed(7.0, 45.0, turn=(0.2, 1.1, 0.0), shift_mm=(-45.0, 5.0, 12.0))
# Without the bend of outlines into rims, and with errors as they are stated.
AS_STATED = with_field(
    MatchTuning(cylinders=CylinderTuning(rim_px=0.0)), "collinear.error_shares", (1.0, 0.0, 0.0)
)


@pytest.fixture(scope="module")
def rig():
    return rig_of(*VIEWS)


def errors_of(found: Cylinders, row: int, true: Placed) -> tuple[np.ndarray, np.ndarray]:
    """(offsets of both ends across the axis and of the radius, their covariance)."""
    ends = found.axis_mm[row]
    across = complete_axes((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))
    first, way = true.axis_mm[0], np.diff(true.axis_mm, axis=0)[0]
    errors = []
    for end in ends:
        # Where the true axis crosses the plane across the found one.
        normal = np.cross(*across)
        reach = ((end - first) @ normal) / (way @ normal)
        errors.append(across @ (end - first - reach * way))
    take = np.zeros((5, 7))
    take[:2, :3] = take[2:4, 3:6] = across
    take[4, 6] = 1.0
    error = np.array([*errors[0], *errors[1], found.radius_mm[row] - true.solid.radius_mm])
    return error, take @ found.covariance_mm2[row] @ take.T


@pytest.mark.parametrize("views", [VIEWS, ("upper", "left"), (*VIEWS, "east")])
def test_exact_outlines_leave_their_cylinders(views, monkeypatch) -> None:
    rig = rig_of(*views)
    cylinders = [UPRIGHT, TILTED] if len(views) > 2 else [UPRIGHT]
    segments = seen_by(rig, cylinders, loose_lines(6, seed=1) if len(views) > 2 else None)
    # Two views leave three conditions alone: what is likely before decides.
    monkeypatch.setattr(cylinder_search, "EVEN", 0.5 if len(views) > 2 else 1e-3)
    found = find_cylinders(nothing_matched(segments), segments, rig)
    assert len(found) == len(cylinders)
    for row in range(len(found)):
        number = int(found.segment[found.cylinder == row].min()) // 2
        true = cylinders[number]
        error, _ = errors_of(found, row, true)
        assert np.abs(error).max() < 1e-6
        ends = found.axis_mm[row]
        ends = ends if (ends[1] - ends[0]) @ (true.axis_mm[1] - true.axis_mm[0]) > 0 else ends[::-1]
        np.testing.assert_allclose(ends, true.axis_mm, atol=1e-6)
        for outlines in found.segments_of(row).values():
            assert outlines.tolist() == [2 * number, 2 * number + 1]
        assert found.degrees[row] == 4 * len(views) - 5
        assert found.chi_square[row] < 1e-6
    if len(views) > 2:
        assert found.posterior.min() > 0.9


def test_errors_are_those_of_their_covariance(rig) -> None:
    squares, fits = [], []
    for seed in range(16):
        segments = seen_by(rig, [TILTED], sigma_px=0.2, seed=seed)
        found = find_cylinders(nothing_matched(segments), segments, rig, tuning=AS_STATED)
        assert len(found) == 1
        error, covariance = errors_of(found, 0, TILTED)
        squares.append(error @ np.linalg.solve(covariance, error))
        fits.append(found.chi_square[0])
    # Means of 16 chi-squares, within four standard deviations.
    for values, degrees in ((squares, 5), (fits, 7)):
        assert abs(np.mean(values) - degrees) < 4 * np.sqrt(2 * degrees / 16)
    assert 0.85 < np.mean(np.array(squares) < chi2.ppf(0.95, 5)) <= 1.0


def test_order_of_views_segments_and_ends_changes_the_numbering_alone(rig) -> None:
    segments = seen_by(rig, [UPRIGHT], loose_lines(5, seed=2), sigma_px=0.1, seed=4)
    found = find_cylinders(nothing_matched(segments), segments, rig)
    turned = {name: np.asarray(segments[name].endpoints_px)[::-1, ::-1] for name in reversed(VIEWS)}
    turned = {
        name: dataclasses.replace(
            segments[name],
            endpoints_px=ends,
            covariance_px2=np.asarray(segments[name].covariance_px2)
            .reshape(-1, 2, 2, 2, 2)[::-1, ::-1, :, ::-1]
            .reshape(-1, 4, 4),
        )
        for name, ends in turned.items()
    }
    again = find_cylinders(nothing_matched(turned), turned, rig)
    assert len(found) == len(again) == 1
    np.testing.assert_allclose(found.radius_mm, again.radius_mm, rtol=1e-9)
    np.testing.assert_allclose(found.posterior, again.posterior, rtol=1e-9)
    count = len(segments["upper"])
    for name in VIEWS:
        renumbered = sorted(count - 1 - again.segments_of(0)[name])
        assert renumbered == found.segments_of(0)[name].tolist()


def test_edges_of_boxes_are_no_cylinder(rig) -> None:
    boxes = [
        box((30.0, 22.0, 25.0)).place(turn_deg=turn, shift_mm=np.array(place)).edges_mm
        for turn, place in ((20.0, (-30.0, 20.0, 0.0)), (-35.0, (30.0, -10.0, 0.0)))
    ]
    segments = seen_by(rig, [], np.concatenate(boxes), sigma_px=0.2, seed=5)
    matches = match_segments(segments, rig)
    # What three views place in space is no outline, so that none is left.
    found = find_cylinders(matches, segments, rig)
    assert found.counts["possible outlines"] == 0
    assert len(found) == 0
    np.testing.assert_array_equal(found.silhouette, np.zeros(len(matches)))
    # If every edge may be an outline, the tracks are no worse an explanation.
    all_open = MatchTuning(cylinders=CylinderTuning(certain_posterior=1.1))
    found = find_cylinders(matches, segments, rig, tuning=all_open)
    assert found.counts["possible outlines"] == 3 * 24
    assert found.posterior.max(initial=0.0) < 0.65


def test_a_track_of_an_outline_is_marked_and_kept(rig) -> None:
    segments = seen_by(rig, [UPRIGHT], loose_lines(5, seed=2), sigma_px=0.1, seed=4)
    # A track of the left outline in two views, which are another line of the body in each.
    matches = match_segments({name: segments[name] for name in VIEWS}, rig)
    fake = nothing_matched(segments)
    ends = np.stack([np.asarray(segments[name].endpoints_px)[[0, 4]] for name in VIEWS], axis=1)
    ends[:, 2] = np.nan
    fake = dataclasses.replace(
        fake,
        index=np.array([[0, 0, -1], [4, 4, -1]]),
        fragments_px=ends,
        lines_mm=np.stack([UPRIGHT.axis_mm, loose_lines(5, seed=2)[2]]),
        covariance_mm2=np.stack([np.eye(6)] * 2),
        stage=np.array(["binocular"] * 2),
        posterior=np.array([0.6, 0.9]),
        rival_posterior=np.zeros(2),
    )
    for each in (fake, matches):
        found = find_cylinders(each, segments, rig)
        assert len(found) == 1
        marked = found.mark(each)
        held = ((each.index >= 0) & (each.index < 2)).any(axis=1)
        expected = np.where(held, found.posterior[0], 0.0)
        np.testing.assert_array_equal(marked.marks["silhouette"], expected)
        assert len(marked) == len(each)


def test_an_axis_through_both_cameras_is_left_open() -> None:
    rig = rig_of("upper", "left")
    centres = [np.asarray(camera.centre_world_mm) for camera in rig.cameras]
    # Seen by both from within one plane: nothing says how far its axis is.
    way = (centres[1] - centres[0]) / np.linalg.norm(centres[1] - centres[0])
    turn = np.cross([0.0, 0.0, 1.0], way)
    angle = np.arccos(way[2])
    lying = Placed(8.0, 40.0, turn=angle * turn / np.linalg.norm(turn))
    segments = seen_by(rig, [lying])
    found = find_cylinders(nothing_matched(segments), segments, rig)
    assert len(found) == 0


def test_views_without_segments_are_named(rig) -> None:
    segments = seen_by(rig, [UPRIGHT])
    with pytest.raises(InputError, match='"right" has none'):
        find_cylinders(nothing_matched(segments), {n: segments[n] for n in ("upper", "left")}, rig)
