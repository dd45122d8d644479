"""Shots of several cameras, from made-up qualities."""

import numpy as np

from tests.capture.made import quality, rectangle
from trinoc.capture.image_quality import ImageQuality
from trinoc.capture.shots import (
    FEWEST_SHOTS,
    Shot,
    advise_cameras,
    connect_cameras,
    find_missing,
    is_new_shot,
    shot_line,
)

ALL, NONE = rectangle(0.01, 0.01, 0.99, 0.99), np.zeros((0, 2))
LOST = quality(NONE, refusal="No sheet was found.")
SOFT = quality(ALL, faults=("edges are 4.0 px wide: hold it still",))
CAMERAS = ("left", "right", "upper")


def shot(**qualities: ImageQuality) -> Shot:
    return Shot("made", {**dict.fromkeys(CAMERAS, LOST), **qualities})


def test_a_shot_is_new_to_one_camera_or_to_two_together() -> None:
    single_views = [shot(left=quality(ALL)), shot(right=quality(ALL))]
    assert is_new_shot([], single_views[0])
    assert is_new_shot(single_views[:1], single_views[1])
    assert not is_new_shot(single_views, single_views[0])
    both = shot(left=quality(ALL), right=quality(ALL))
    assert is_new_shot(single_views, both)
    assert not is_new_shot([*single_views, both], both)
    assert not is_new_shot([], shot(left=SOFT))


def test_cameras_are_connected_in_chains() -> None:
    good = quality(ALL)
    chain = [shot(left=good, right=good), shot(right=good, upper=good)]
    assert connect_cameras(FEWEST_SHOTS * chain[:1], CAMERAS) == [("left", "right"), ("upper",)]
    assert connect_cameras(FEWEST_SHOTS * chain, CAMERAS) == [CAMERAS]
    assert connect_cameras(chain, CAMERAS) == [("left",), ("right",), ("upper",)]


def test_what_is_missing_is_said() -> None:
    good = quality(ALL)
    few = FEWEST_SHOTS * [shot(left=good), shot(right=good)]
    missing = find_missing(few, CAMERAS)
    assert missing is not None
    assert 'only 0 good pictures of "upper"' in missing
    unconnected = [*few, *(FEWEST_SHOTS * [shot(upper=good)])]
    missing = find_missing(unconnected, CAMERAS)
    assert missing is not None
    assert "left and right at the same time" in missing
    assert find_missing(FEWEST_SHOTS * [shot(left=good, right=good, upper=good)], CAMERAS) is None


def test_the_camera_that_lacks_most_comes_next() -> None:
    part, good = quality(rectangle(0.4, 0.01, 0.99, 0.99)), quality(ALL)
    together = FEWEST_SHOTS * [shot(left=good, right=good, upper=part)]
    advice = advise_cameras(together, CAMERAS)
    assert advice.sentence.startswith("For upper: Move the board to the")
    assert list(advice.goals) == ["upper"]
    unconnected = [shot(left=good), shot(right=good), shot(upper=good)]
    assert "sees it together with right" in advise_cameras(unconnected, CAMERAS).sentence
    assert "Again, left: edges are 4.0" in advise_cameras([shot(left=SOFT)], CAMERAS).sentence
    assert "Reason for left: No sheet was found." in advise_cameras([shot()], CAMERAS).sentence


def test_a_shot_is_one_line() -> None:
    line = shot_line(shot(left=quality(ALL), right=SOFT)._replace(saved_name="shot_0001"))
    assert line == (
        "made: kept as shot_0001; left good, right AGAIN (edges are 4.0 px wide: hold it still), "
        "upper not found"
    )
