"""A batch returns the result and the status of each item."""

import numpy as np
import pytest

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.match import match_many
from trinoc.match.batch import OK
from trinoc.match.matcher import match_segments

VIEWS = ("upper", "left", "right")


def test_a_batch_gives_what_its_items_give_and_a_bad_item_spoils_no_other() -> None:
    rigs = [rig_of(*VIEWS), rig_of("upper", "right"), rig_of(*VIEWS)]
    frames = [pictures(rig_of(*VIEWS), loose_lines(20 + k, seed=k), 0.3, seed=k) for k in range(3)]
    batch = match_many(frames, rigs)
    assert len(batch) == 3
    assert (batch.status[0], batch.status[2]) == (OK, OK)
    assert '"left"' in batch.status[1]
    assert batch.matches[1] is None
    for k in (0, 2):
        alone, in_batch = match_segments(frames[k], rigs[k]), batch.matches[k]
        assert in_batch is not None
        np.testing.assert_array_equal(in_batch.index, alone.index)
        np.testing.assert_allclose(in_batch.lines_mm, alone.lines_mm, rtol=1e-9)


@pytest.mark.slow
def test_frames_of_one_stack_learn_their_own_parameters() -> None:
    # Rigs, numbers of views and of segments, and noise beyond what is stated, which takes
    # another pass, differ by frame.
    east, upper = rig_of("upper", "left", "east"), rig_of(*VIEWS)
    rigs = [east, upper, upper, upper, upper]
    frames = [
        pictures(rig, loose_lines(count, seed=count), noise_px, seed=count)
        for rig, count, noise_px in zip(rigs, (25, 21, 30, 1, 22), (0.3, 0.3, 3.0, 0.3, 0.3))
    ]
    del frames[4]["right"]
    batch = match_many(frames, rigs)
    for frame, rig, in_batch in zip(frames, rigs, batch.matches, strict=True):
        alone = match_segments(frame, rig)
        assert in_batch is not None
        assert in_batch.counts == alone.counts
        np.testing.assert_array_equal(in_batch.index, alone.index)
        np.testing.assert_allclose(in_batch.posterior, alone.posterior, atol=1e-9)
        np.testing.assert_allclose(in_batch.noise_scale, alone.noise_scale)
        for view in alone.views:
            np.testing.assert_array_equal(in_batch.reasons[view], alone.reasons[view])
    scales = [in_batch.noise_scale for in_batch in batch.matches if in_batch is not None]
    assert max(scales) > 2 * scales[0]


def test_stacks_on_several_threads_give_what_one_stack_gives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = rig_of(*VIEWS)
    frames = [pictures(rig, loose_lines(12 + k, seed=k), 0.3, seed=k) for k in range(5)]
    one = match_many(frames, rig)
    monkeypatch.setattr("trinoc.match.batch.FRAMES_AT_ONCE", 2)
    several = match_many(frames, rig)
    for matches, expected in zip(several.matches, one.matches, strict=True):
        assert matches is not None
        assert expected is not None
        np.testing.assert_array_equal(matches.index, expected.index)
        np.testing.assert_allclose(matches.lines_mm, expected.lines_mm, rtol=1e-9)


def test_one_rig_serves_all_items_and_no_items_are_no_matches() -> None:
    rig = rig_of(*VIEWS)
    frames = [pictures(rig, loose_lines(20, seed=k)) for k in range(2)]
    assert (match_many(frames, rig).status == OK).all()
    assert len(match_many([], rig)) == 0
    with pytest.raises(ValueError, match="zip"):
        match_many(frames, [rig])
