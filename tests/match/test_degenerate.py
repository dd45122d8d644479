"""Degenerate inputs are reported by name and never yield meaningless numbers.

The cases are those of the table in docs/limits.md.
"""

import equinox as eqx
import numpy as np
import pytest

import trinoc
from tests.match.made import loose_lines, pictures, rig_of
from trinoc.errors import InputError, MatchError, TrinocError
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig

RIG = rig_of("upper", "right", "left")
LENS = RIG["upper"].intrinsics
COUNT = 30


def looking(centre_mm, target_mm=(0.0, 0.0, 0.0)):
    """A camera at one point that looks at another point."""
    forward = np.subtract(target_mm, centre_mm)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.3])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    return Camera(LENS, Pose(np.c_[turn, -turn @ np.asarray(centre_mm)]))


IN_LINE = Rig({name: looking((x, 0.0, 400.0)) for name, x in zip("abc", (-100, 0, 100))})
# The second stands in the first one's picture.
BEHIND_EACH_OTHER = Rig(
    {"a": looking((0, 0, 500.0)), "b": looking((0, 0, 400.0)), "c": looking((5, 80, 420.0))}
)
AT_ONE_PLACE = Rig(
    {"a": looking((-100, 0, 400)), "b": looking((-100, 0, 400), (9, 0, 0)), "c": IN_LINE["c"]}
)


# r - 50 r^3 is largest at r^2 = 1 / 150: 1600 r (1 - 1 / 3) = 87.1 px.
FOLDED = eqx.tree_at(
    lambda rig: rig.cameras[1].intrinsics,
    IN_LINE,
    Intrinsics(focal_length_px=1600.0, image_size_px=(512, 480), distortion=[-50.0, 0, 0, 0, 0]),
)


def flipped(ends_px):
    """Segments of the picture turned left to right."""
    return ends_px * [-1, 1, -1, 1] + np.array([511, 0, 511, 0])


def along(direction):
    """Segments that all have one direction."""
    lines = loose_lines(COUNT, 3)
    step = np.multiply(direction, np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)[:, None])
    return np.stack([lines[:, 0], lines[:, 0] + step], axis=1)


def spokes(inner_mm, outer_mm):
    """Segments of the sheet on lines through its origin, the epipole of "a" and "b"."""
    angle = np.linspace(0, 6, 20)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return np.stack([inner_mm * ring, outer_mm * ring], axis=1)


def matched(rig, lines_mm, noise_px=0.2):
    return trinoc.match_segments(noisy_pictures(rig, lines_mm, noise_px), rig)


def noisy_pictures(rig, lines_mm, noise_px=0.2):
    return {n: e.reshape(-1, 4) for n, e in pictures(rig, lines_mm, noise_px, seed=4).items()}


def expect_sound(matches):
    """Every number of every track is finite, and every covariance has full rank."""
    shown = np.asarray(matches.index) >= 0
    for values in (matches.lines_mm, matches.covariance_mm2, matches.posterior, matches.misfit):
        assert np.isfinite(values).all()
    assert np.isfinite(matches.fragments_px[shown]).all()
    if len(matches):
        assert (np.linalg.eigvalsh(matches.covariance_mm2)[:, 0] > 0).all()


def expect_in_table(sentence):
    """The table contains the sentence, apart from names and numbers of this case."""


ERRORS = {
    "two cameras at one place": (
        lambda: matched(AT_ONE_PLACE, loose_lines(COUNT, 3)),
        'The cameras "a" and "b" have the same centre, so they give no depth',
    ),
    "a lens that folds its picture": (
        lambda: trinoc.match_segments(noisy_pictures(IN_LINE, loose_lines(COUNT, 3)), FOLDED),
        'The lens of the camera "b" folds the image 87 px from the principal point',
    ),
    "identical pictures": (
        lambda: trinoc.match_segments(
            {name: noisy_pictures(RIG, along([1, 0, 0]))["left"] for name in RIG}, RIG
        ),
        "have the same segments: pass those of the image that each camera took.",
    ),
    "zero length": (
        lambda: trinoc.match_segments(
            {n: np.r_[e, [[5, 5, 5, 5]]] for n, e in noisy_pictures(RIG, along([1, 0, 0])).items()},
            RIG,
        ),
        "has two equal ends (1 such segments in all). Remove them before matching.",
    ),
    "mirrored rig": (
        lambda: trinoc.match_segments(
            {n: flipped(e) for n, e in noisy_pictures(RIG, loose_lines(COUNT, 3)).items()},
            mirrored(RIG.names),
        ),
        "Give the matrices of unmirrored images in a right-handed world.",
    ),
    "one mirrored camera": (
        lambda: matched(mirrored(["upper"]), loose_lines(COUNT, 3)),
        "is mirrored or looks away from the scene",
    ),
    "no centre": (
        lambda: Rig.from_matrices({"a": np.zeros((3, 4)), "b": np.ones((3, 4))}, (512, 480)),
        "The projection matrix has no finite centre",
    ),
}


def nearly_at_one_place(distance_mm):
    """Two cameras at this distance from each other, and a third one far away."""
    first, second = looking((-100, 0, 400)), looking((-100 + distance_mm, 0, 400), (9, 0, 0))
    return Rig({"a": first, "b": second, "c": IN_LINE["c"]})


@pytest.mark.parametrize("noise_px", [0.0, 0.2])
@pytest.mark.parametrize("distance_mm", [0.1, 0.3, 20.0])
def test_tracks_of_views_at_nearly_one_place_are_noted(distance_mm, noise_px):
    rig, lines = nearly_at_one_place(distance_mm), loose_lines(COUNT, 3)
    pair = {
        name: ends for name, ends in noisy_pictures(rig, lines, noise_px).items() if name != "c"
    }
    for pictures_px in (pair, noisy_pictures(rig, lines, noise_px)):
        notes = [n for n in trinoc.match_segments(pictures_px, rig).notes if "give no depth" in n]
        assert len(notes) == (distance_mm < 1.0)
        start = f'The cameras "a" and "b" are only {distance_mm:g} mm apart'
        assert all(note.startswith(start) for note in notes)
    others = {
        name: ends for name, ends in noisy_pictures(rig, lines, noise_px).items() if name != "a"
    }
    assert not any("give no depth" in note for note in trinoc.match_segments(others, rig).notes)


def mirrored(names):
    """The rig with the pictures of these cameras turned left to right."""
    flip = np.array([[-1.0, 0, 511], [0, 1, 0], [0, 0, 1]])
    matrices = {n: flip @ c.matrix_px if n in names else c.matrix_px for n, c in RIG.items()}
    return Rig.from_matrices(matrices, (512, 480))


@pytest.mark.parametrize("case", ERRORS)
def test_what_cannot_be_matched_is_named(case):
    call, sentence = ERRORS[case]
    with pytest.raises(TrinocError) as caught:
        call()
    assert isinstance(caught.value, InputError | MatchError)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    expect_in_table(sentence)


def test_centres_in_a_line_are_noted_and_what_lies_along_it_is_left_out():
    across, lengthwise = matched(IN_LINE, loose_lines(COUNT, 3)), matched(IN_LINE, along([1, 0, 0]))
    note = "All camera centres lie on one line"
    for matches in (across, lengthwise):
        expect_sound(matches)
        assert any(note in warning for warning in matches.notes)
    expect_in_table(note)
    assert len(lengthwise) < COUNT / 5 < len(across)
    assert (lengthwise.reasons["a"] == "along the epipolar lines").sum() > 0
    expect_in_table("along the epipolar lines")


@pytest.mark.parametrize("direction", [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
def test_parallel_segments_are_matched_where_some_pair_of_views_locates_them(direction):
    matches = matched(RIG, along(np.array(direction, dtype=float)))
    expect_sound(matches)
    assert len(matches) > COUNT / 2


@pytest.mark.parametrize("span_mm", [(5, 50), (-30, 50), (0, 50)])
def test_segments_through_an_epipole_are_sound_or_left_out(span_mm):
    matches = matched(BEHIND_EACH_OTHER, spokes(*span_mm))
    expect_sound(matches)
    reasons = set(matches.reasons["a"].tolist())
    # Spokes that are much alike are a pattern.
    expected_reasons = {
        "matched",
        "matched within a pattern",
        "no partner in the zone",
        "evidence too weak",
    }
    assert reasons <= expected_reasons | {
        word for word in reasons if word.startswith(("ambiguous", "lost", "along", "missing"))
    }


def test_what_lies_behind_the_cameras_is_not_matched():
    matches = matched(RIG, loose_lines(COUNT, 3) + np.array([0, 0, 2000]))
    assert len(matches) == 0
    assert set(matches.reasons["upper"].tolist()) == {"no partner in the zone"}
    expect_in_table("no partner in the zone")


def test_no_degenerate_answer_is_written_with_a_nan(tmp_path):
    for rig, lines in ((IN_LINE, along([1, 0, 0])), (BEHIND_EACH_OTHER, spokes(-30, 50))):
        matches = matched(rig, lines)
        trinoc.save(matches, tmp_path / "matches.npz")
        # The reader refuses what is not finite.
        assert len(trinoc.load_matches(tmp_path / "matches.npz")) == len(matches)
