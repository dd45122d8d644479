"""A board with markers that differs from the stated one is named by the layout that fits."""

from dataclasses import replace

import numpy as np
import pytest

from tests.calib.detection.test_boards import picture
from trinoc.calib import detect_target
from trinoc.calib.detection import marker_readings
from trinoc.calib.detection.marker_readings import ReadingSearch, find_marker_reading
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.starts.pictures import find_boards
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.board_set import BoardSet
from trinoc.calib.targets.checkers import Charuco, opencv_board
from trinoc.calib.targets.markers import opencv_dictionary
from trinoc.calib.tuning.every_group import TUNING
from trinoc.errors import CalibrationError, DetectionError

CHARUCO = Charuco(rows=6, columns=8, square_mm=11.0, marker_mm=8.25, dictionary="4x4_50")
APRILGRID = AprilGrid(rows=3, columns=4, tag_mm=18.0)
# Differences between the print and the stated board, by the words of the message.
PRINTS = {
    "legacy=yes": {"legacy": True},
    "rows and columns exchanged (rows=8 columns=6)": {"rows": 8, "columns": 6},
    "inverted=yes": {"inverted": True},
    "mirrored=yes": {"mirrored": True},
    "inverted=yes and mirrored=yes": {"inverted": True, "mirrored": True},
    "inverted=yes and legacy=yes": {"inverted": True, "legacy": True},
    "mirrored=yes and legacy=yes": {"mirrored": True, "legacy": True},
    "legacy=yes and rows and columns exchanged (rows=8 columns=6)": {
        "legacy": True,
        "rows": 8,
        "columns": 6,
    },
    "mirrored=yes and rows and columns exchanged (rows=8 columns=6)": {
        "mirrored": True,
        "rows": 8,
        "columns": 6,
    },
    "first=20": {"first": 20},
    "dictionary=5x5_50": {"dictionary": "5x5_50"},
    "dictionary=6x6_50": {"dictionary": "6x6_50"},
    "dictionary=APRILTAG_16h5": {"dictionary": "APRILTAG_16h5"},
    "dictionary=APRILTAG_36h11": {"dictionary": "APRILTAG_36h11"},
    "dictionary=4x4_100 and first=60": {"dictionary": "4x4_100", "first": 60},
}
# The most searches for markers in a refused image: four looks, and nine families of dictionaries.
MOST_SEARCHES = 13


def refusal(image, board):
    with pytest.raises(DetectionError) as caught:
        detect_target(image, board)
    return str(caught.value)


@pytest.fixture
def searches(monkeypatch):
    """List of the images that were searched for markers to explain a refusal."""
    calls = []

    def counted(find):
        def search(grey, *others):
            calls.append(grey.shape)
            return find(grey, *others)

        return search

    for name in ("_find_markers", "list_quadrangles"):
        monkeypatch.setattr(marker_readings, name, counted(getattr(marker_readings, name)))
    return calls


@pytest.mark.parametrize("changes", PRINTS)
def test_another_print_than_the_stated_one_is_named_and_then_fits(changes, searches):
    printed = replace(CHARUCO, **PRINTS[changes])
    image, pixels = picture(printed)
    sentence = refusal(image, CHARUCO)
    assert f"fits with {changes}" in sentence
    mirror = " as in a mirror" if printed.mirrored else ""
    assert f"24 markers of {printed.dictionary} are visible{mirror}; " in sentence
    assert len(searches) <= MOST_SEARCHES
    # The named board is the printed one.
    detection = detect_target(image, printed)
    corners = printed.centres_mm[detection.circle_index]
    assert len(detection) == len(printed)
    assert np.abs(detection.centres_px - pixels(corners)).max() < 0.25


@pytest.mark.parametrize("legacy", [False, True])
def test_a_pattern_that_differs_by_a_shift_is_named(legacy):
    """With an odd number of columns OpenCV finds corners one column from where they are."""
    board = Charuco(rows=6, columns=9, square_mm=11.0, dictionary="4x4_50", legacy=legacy)
    image, pixels = picture(board)
    detection = detect_target(image, board)
    assert len(detection) == len(board)
    assert np.abs(detection.centres_px - pixels(board.centres_mm)).max() < 0.25
    sentence = refusal(image, replace(board, legacy=not legacy))
    assert f"fits with legacy={'yes' if legacy else 'no'}" in sentence


@pytest.mark.parametrize("changes", [changes for changes in PRINTS if "=yes" in changes])
def test_a_plain_print_is_named_where_another_one_is_stated(changes):
    image, _ = picture(CHARUCO)
    stated = replace(CHARUCO, **PRINTS[changes])
    reading = find_marker_reading(image, stated, TUNING)
    assert reading is not None
    assert reading.board == replace(CHARUCO, name=stated.name)
    assert changes.replace("=yes", "=no").replace("8 columns=6", "6 columns=8") in refusal(
        image, stated
    )


def test_the_image_of_a_mirror_is_named_as_that():
    image, _ = picture(CHARUCO)
    sentence = refusal(image[:, ::-1].copy(), CHARUCO)
    assert "as in a mirror" in sentence
    assert "mirrored=yes" in sentence
    assert "back of a two-sided board" in sentence
    assert "flip" not in sentence


@pytest.mark.parametrize("legacy", [False, True])
def test_opencv_s_own_drawing_of_the_other_pattern_is_named(legacy):
    stated = replace(CHARUCO, legacy=not legacy)
    theirs = opencv_board(replace(CHARUCO, legacy=legacy))
    image = theirs.generateImage((800, 620), marginSize=20)
    assert f"fits with legacy={'yes' if legacy else 'no'}" in refusal(image, stated)
    assert f"fits with inverted=yes and legacy={'yes' if legacy else 'no'}" in refusal(
        255 - image, stated
    )


GRIDS = {
    "rows and columns exchanged (rows=4 columns=3)": {"rows": 4, "columns": 3},
    "first=20": {"first": 20},
    "border=1": {"border": 1},
    "dictionary=APRILTAG_25h9": {"dictionary": "APRILTAG_25h9"},
    "dictionary=APRILTAG_36h10": {"dictionary": "APRILTAG_36h10"},
    "dictionary=APRILTAG_25h9 and border=1": {"dictionary": "APRILTAG_25h9", "border": 1},
}


@pytest.mark.parametrize("changes", GRIDS)
def test_another_grid_of_tags_is_named_and_then_fits(changes, searches):
    printed = replace(APRILGRID, **GRIDS[changes])
    image, _ = picture(printed)
    assert f"fits with {changes}" in refusal(image, APRILGRID)
    assert len(searches) <= 2
    assert len(detect_target(image, printed)) == len(printed)


def test_a_grid_of_tags_in_a_mirror_is_named():
    image, _ = picture(APRILGRID)
    sentence = refusal(image[:, ::-1].copy(), APRILGRID)
    assert "12 tags of APRILTAG_36h11 are visible as in a mirror" in sentence


@pytest.mark.parametrize("board", [CHARUCO, APRILGRID], ids=["charuco", "aprilgrid"])
def test_nothing_is_claimed_without_markers_or_where_the_stated_board_is_in_view(board, searches):
    image, _ = picture(board)
    # All but the middle: the layout is right, and too little of it is in view.
    part = np.full_like(image, 128)
    part[150:330, 220:420] = image[150:330, 220:420]
    noise = np.random.default_rng(0).integers(0, 255, image.shape).astype(np.uint8)
    for shown in (image, part, noise, np.full_like(image, 90)):
        assert find_marker_reading(shown, board, TUNING) is None
    assert "no " in refusal(noise, board)
    assert "fits" not in refusal(noise, board)
    assert max(np.bincount(np.arange(len(searches)) // MOST_SEARCHES)) <= MOST_SEARCHES


@pytest.mark.parametrize("look", ["inverted", "mirrored"])
def test_corners_of_another_print_are_those_of_the_plain_one(look):
    """Neither exchanged black and white nor a mirror moves the corners."""
    image, _ = picture(CHARUCO)
    plain = detect_target(image, CHARUCO)
    other = 255 - image if look == "inverted" else np.ascontiguousarray(image[:, ::-1])
    detection = detect_target(other, replace(CHARUCO, **{look: True}))
    np.testing.assert_array_equal(detection.circle_index, plain.circle_index)
    centres_px = detection.centres_px.copy()
    if look == "mirrored":
        centres_px[:, 0] = image.shape[1] - 1 - centres_px[:, 0]
    np.testing.assert_allclose(centres_px, plain.centres_px, atol=0.02)
    variances = [np.linalg.eigvalsh(each.covariance_px2) for each in (detection, plain)]
    np.testing.assert_allclose(*variances, rtol=0.1)


def test_images_of_a_recording_share_what_was_found_and_are_searched_a_few_times(searches):
    other, _ = picture(replace(CHARUCO, dictionary="6x6_50"))
    blank = np.full_like(other, 90)
    search = ReadingSearch(CHARUCO, most_images=2)
    assert search.find(blank, "left") is None
    assert search.find(other, "left") is not None
    full = len(searches)
    # One search each, with the reading that is known.
    for camera in ("left", "right", "left"):
        reading = search.find(other, camera)
        assert reading is not None
        assert reading.changes == ("dictionary=6x6_50",)
    assert len(searches) == full + 3
    absent = ReadingSearch(CHARUCO, most_images=2)
    for _ in range(5):
        assert absent.find(blank, "left") is None
    assert absent.is_over("left")
    assert not absent.is_over("right")
    assert len(searches) <= full + 3 + 2 * MOST_SEARCHES


def shown(board, turns_deg):
    return [picture(board, turn_deg)[0] for turn_deg in turns_deg]


@pytest.mark.parametrize("changes", ["legacy=yes", "inverted=yes", "inverted=yes and legacy=yes"])
def test_a_recording_of_the_same_sheet_is_read_as_it_was_printed(changes):
    printed = replace(CHARUCO, **PRINTS[changes])
    blank = np.full((480, 640), 90, np.uint8)
    images = [blank] * 5 + shown(printed, (10.0, 80.0))
    boards = find_boards({"left": images, "right": images}, CHARUCO)
    assert boards.target == replace(printed, name=CHARUCO.name)
    assert f"with {changes}" in boards.remarks[0]
    assert [len(camera_detections) for camera_detections in boards.detections.values()] == [2, 2]
    # The name of the stated board stays in the failures of the others.
    assert len(boards.failures) == 10


def test_a_set_s_board_is_read_as_it_was_printed():
    front = AprilGrid(rows=2, columns=2, tag_mm=20.0)
    image = shown(replace(CHARUCO, inverted=True), (0.0,))[0]
    boards = find_boards({"left": [image]}, BoardSet({"front": front, "back": CHARUCO}))
    assert isinstance(boards.target, BoardSet)
    assert boards.target.boards[1] == replace(CHARUCO, inverted=True)
    assert len(boards.detections["left"]["shot 1"]) == len(CHARUCO)
    assert '"back" with inverted=yes' in boards.remarks[0]


def test_a_camera_that_sees_the_back_of_a_two_sided_board_is_told_so():
    front, back = shown(CHARUCO, (0.0, 20.0)), shown(replace(CHARUCO, mirrored=True), (0.0, 20.0))
    with pytest.raises(CalibrationError, match=r'camera "far".*mirrored=yes.*two-sided'):
        calibrate_rig({"near": front, "far": back}, CHARUCO)
    with pytest.raises(CalibrationError, match=r"In \w+ 1: 24 markers.*mirrored=yes"):
        calibrate_intrinsics(back, CHARUCO)


def test_a_two_sided_board_is_a_set_of_a_front_and_a_mirrored_back():
    two_sided = BoardSet({"front": CHARUCO, "back": replace(CHARUCO, mirrored=True)})
    for which, board in enumerate(two_sided.boards):
        image, pixels = picture(board)
        detection = detect_target(image, two_sided)
        assert (two_sided.board_of_point[detection.circle_index] == which).all()
        corners = two_sided.centres_mm[detection.circle_index]
        assert np.abs(detection.centres_px - pixels(corners)).max() < 0.25


@pytest.mark.parametrize("beyond_px", [0, 1, 2, 4])
def test_corners_at_the_very_edge_of_a_picture_are_right_or_left_out(beyond_px):
    """Their windows have hardly any pair of opposite pixels, which separates noise from misfit."""
    image, pixels = picture(CHARUCO, 0.0, slant=0.0)
    corners_px = pixels(CHARUCO.centres_mm)
    # The last column of corners lies so many pixels from the right edge.
    edge = int(np.rint(corners_px[:, 0].max())) + beyond_px + 1
    cut = np.ascontiguousarray(image[:, :edge])
    with np.errstate(all="raise", under="ignore"):
        detection = detect_target(cut, CHARUCO)
    assert len(detection) >= 0.7 * len(CHARUCO)
    error_px = detection.centres_px - corners_px[detection.circle_index]
    assert np.abs(error_px).max() < 0.25
    assert (np.linalg.eigvalsh(detection.covariance_px2) > 0).all()


def test_a_marker_of_another_sheet_does_not_shift_the_first_one():
    """The last row is covered, and a marker with a far smaller number lies beside the board."""
    printed = replace(CHARUCO, dictionary="4x4_1000", first=95)
    image, _ = picture(printed)
    grey = np.asarray(image, dtype=np.uint8)
    all_markers = marker_readings._find_markers(
        grey, printed, opencv_dictionary(printed.dictionary)
    )
    markers = {number: corners for number, corners in all_markers.items() if number < 95 + 20}
    markers[5] = markers[95] + 300.0
    stated = replace(printed, first=300)
    readings = list(marker_readings._read_other_first(markers, stated, TUNING))
    assert [reading.board.first for reading in readings] == [95]
