"""Segments beyond the fold of a lens are excluded, and the others are matched."""

import numpy as np
import pytest

import trinoc
from tests.match.made import loose_lines, pictures, rig_of
from trinoc.errors import MatchError
from trinoc.geometry import distort_pixels
from trinoc.geometry.rig import Rig
from trinoc.match.observations.match_input import BEYOND_FOLD

NAMES = ("upper", "left", "right")
IDEAL = rig_of(*NAMES)


def bent_pictures(rig: Rig, lines_mm: np.ndarray) -> dict[str, np.ndarray]:
    """Images of lines through the lenses of a rig, with noise."""
    return {
        name: distort_pixels(rig[name].intrinsics, ends)
        for name, ends in pictures(IDEAL, lines_mm, 0.2, seed=4).items()
    }


def test_segments_beyond_the_fold_are_left_out_with_a_note_and_the_others_are_matched():
    rig = rig_of(*NAMES, distortion=(-1.6,))
    lens = rig["left"].intrinsics
    assert 290 < lens.valid_radius_px < 310
    inside = bent_pictures(rig, loose_lines(40, 3))
    is_inside = np.all([np.isfinite(ends).all(axis=(1, 2)) for ends in inside.values()], axis=0)
    inside = {name: ends[is_inside] for name, ends in inside.items()}
    expected = trinoc.match_segments(inside, rig)
    assert len(expected) > 10
    assert not any("one to one" in note for note in expected.notes)
    corner = np.array([[[2.0, 3.0], [40.0, 9.0]], [[0.0, 0.0], [200.0, 180.0]]])
    with_corner = inside | {"left": np.concatenate([corner, inside["left"]])}
    matches = trinoc.match_segments(with_corner, rig)
    (note,) = [note for note in matches.notes if "one to one" in note]
    assert f'2 segments of "left" beyond {lens.valid_radius_px:.0f} px' in note
    assert matches.reasons["left"][:2].tolist() == [BEYOND_FOLD] * 2
    assert matches.reasons["left"][2:].tolist() == expected.reasons["left"].tolist()
    assert matches.counts[f"segments {BEYOND_FOLD}"] == 2
    shift = np.array([2 if name == "left" else 0 for name in matches.views])
    moved = np.where(expected.index >= 0, expected.index + shift, -1)
    np.testing.assert_array_equal(matches.index, moved)
    np.testing.assert_array_equal(matches.lines_mm, expected.lines_mm)
    assert np.isfinite(matches.fragments_px[matches.index >= 0]).all()


def test_a_view_all_of_whose_segments_lie_beyond_has_no_tracks():
    rig = rig_of(*NAMES, distortion=(-1.6,))
    corner = np.array([[[2.0, 3.0], [40.0, 9.0]], [[4.0, 0.0], [4.0, 50.0]]])
    inside = bent_pictures(rig, loose_lines(40, 3))
    pictures_px = {
        name: corner if name == "left" else ends[np.isfinite(ends).all(axis=(1, 2))]
        for name, ends in inside.items()
    }
    matches = trinoc.match_segments(pictures_px, rig)
    assert (matches.index[:, matches.views.index("left")] == -1).all()
    assert set(matches.reasons["left"]) == {BEYOND_FOLD}


def test_a_lens_of_whose_image_too_little_is_left_is_refused():
    rig = rig_of(*NAMES, distortion=(-6.0,))
    with pytest.raises(MatchError, match=r'The lens of the camera ".*" folds the image'):
        trinoc.match_segments(pictures(IDEAL, loose_lines(10, 3)), rig)
