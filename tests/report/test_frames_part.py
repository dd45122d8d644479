"""All frames of a recording in one look: nothing is lost between frames and charts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.io.formats.bench import bench_matches
from trinoc.errors import InputError
from trinoc.match.tracks.matches import SUSPECT_SETS, TRINOCULAR, Matches
from trinoc.report.checks import Level, Subject
from trinoc.report.frames_part import COLUMNS, LEAST_RUN, RUNS, frames_part
from trinoc.report.html import render_report
from trinoc.report.verdict import find_verdict
from trinoc.synth import table1_rig

WHOLE = bench_matches()


def with_tracks(count: int, noise_scale: float = 1.0) -> Matches:
    """Matches with a given number of tracks in three views."""
    stage = np.where(np.arange(len(WHOLE)) < count, TRINOCULAR, "binocular")
    return replace(WHOLE, stage=stage, noise_scale=noise_scale)


def doubted(matches: Matches) -> Matches:
    return replace(matches, notes=("exchanged.",), counts=matches.counts | {SUSPECT_SETS: 1})


@given(st.lists(st.integers(0, 4) | st.none(), min_size=1, max_size=60))
def test_a_chart_holds_every_frame(tracks):
    counts = [count for count in tracks if count is not None]
    frames = {str(k): None if n is None else with_tracks(n) for k, n in enumerate(tracks)}
    failures = {name: "no picture" for name, each in frames.items() if each is None}
    if not counts:
        with pytest.raises(InputError, match="Every frame failed"):
            frames_part(frames, failures)
        return
    part = frames_part(frames, failures)
    chart = part.charts[0]
    lowest, median, highest = (chart.points * max(max(counts), 1)).T
    assert (np.nanmin(lowest), np.nanmax(highest)) == pytest.approx((min(counts), max(counts)))
    assert (~(lowest > median) & ~(median > highest)).all()
    assert len(part.bad) == len(failures)
    assert {fate.name for fate in part.to_look_at if fate.problem == "no picture"} == set(failures)
    # The frame that is shown lies nearer the median than any other that worked.
    shown = frames[part.middle]
    assert shown is not None
    track_count = int((shown.stage == TRINOCULAR).sum())
    assert abs(track_count - np.median(counts)) == min(abs(n - np.median(counts)) for n in counts)


def test_many_frames_share_columns_and_none_is_dropped():
    frames = {str(k): with_tracks(0 if k == 777 else 3) for k in range(3 * COLUMNS)}
    part = frames_part(frames, {})
    (lowest, median, highest) = part.charts[0].points.T
    assert len(median) == COLUMNS
    assert (lowest.min(), median.min(), highest.min()) == (0, 1, 1)
    assert [fate.name for fate in part.to_look_at] == ["777"]


def test_a_camera_that_is_knocked_on_the_way_shows_in_the_runs():
    count = RUNS * LEAST_RUN
    frames = {str(k): with_tracks(3, 1.0 if k < 0.7 * count else 4.0) for k in range(count)}
    part = frames_part(frames, {})
    assert part.agreement.tolist() == pytest.approx([1.0] * 7 + [4.0] * 3)
    verdict = find_verdict(Subject(matches=with_tracks(3), recording=part))
    assert verdict is not None
    (row,) = (check for check in verdict.checks if check.question.startswith("Do the views agree"))
    assert row.level is Level.CARE
    assert row.figure == "1.00 to 4.00 times their sigma"


@pytest.mark.parametrize(
    ("suspect", "level"), [(0, Level.GOOD), (1, Level.CARE), (6, Level.BAD), (10, Level.BAD)]
)
def test_frames_that_are_suspect_are_counted_and_told(suspect, level):
    frames = {str(k): doubted(with_tracks(3)) if k < suspect else with_tracks(3) for k in range(10)}
    part = frames_part(frames, {})
    verdict = find_verdict(Subject(matches=with_tracks(3), recording=part))
    assert verdict is not None
    row = verdict.checks[0]
    assert (row.level, row.figure) == (level, f"{10 - suspect} of 10 frames have no problem")
    assert [fate.problem for fate in part.to_look_at] == ["exchanged."] * suspect
    page = render_report(
        rig=table1_rig(), matches=frames[part.middle], recording=part, title="Recording"
    )
    assert page.count("exchanged.") >= suspect
    assert 'id="recording"' in page
