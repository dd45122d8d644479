"""Results of all frames of a recording: tracks over time, and the frames to look at."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.match.tracks.matches import TRINOCULAR, Matches, MatchStatus
from trinoc.match.tracks.reliability import assess_matches
from trinoc.report.matches_part import share_matched
from trinoc.report.numbers import percent, with_decimals
from trinoc.report.report_table import ReportTable

# A chart has at most so many columns, of several frames each in long recordings.
COLUMNS = 400
# Rows of the table of frames to look at.
LISTED = 50
# A frame with less than this share of the median of tracks is one to look at.
FEW = 0.5
# The views' agreement is judged over so many frames in a row, and no fewer than some.
RUNS, LEAST_RUN = 10, 5


class FrameFate(NamedTuple):
    """Result of one frame of a recording.

    Attributes
    ----------
    name : str
        Name of the frame.
    tracks : float
        Number of tracks in three views or more, or in both of two views. NaN if the frame failed.
    share : float
        Share of all segments that are on a track, 0 to 1. NaN if the frame failed.
    agreement : float
        Noise scale of the matches: estimated over stated sigma. NaN without tracks in three views.
    problem : str
        Reason why the frame failed or is suspect; "" for a good frame.
    status : str
        Status of the matches in small letters, or "failed".
    care : str
        Reason why the matches are to be used with care; "" if they are not.
    """

    name: str
    tracks: float
    share: float
    agreement: float
    problem: str
    status: str
    care: str = ""


class FrameChart(NamedTuple):
    """Chart of one number over the frames of a recording.

    Attributes
    ----------
    title : str
        Title of the chart.
    low, high : str
        Lower and upper end of the axis, as text.
    points : (n, 3)
        Least, median and largest number of the frames in each column, as shares of the axis. A
        column stands for one frame or several consecutive ones.
    """

    title: str
    low: str
    high: str
    points: Float[np.ndarray, "n 3"]


class FramesPart(NamedTuple):
    """Section of the report with all frames of a recording.

    Attributes
    ----------
    frames : tuple of FrameFate
        Results of all frames.
    charts : tuple of FrameChart
        Charts over all frames.
    bad : tuple of float
        Positions of the frames with a problem on the charts' axis, 0 to 1.
    to_look_at : tuple of FrameFate
        Frames with a problem or few tracks, at most `LISTED`.
    omitted : int
        Number of such frames that `to_look_at` omits.
    middle : str
        Name of the frame with the median number of tracks, which the report shows in full.
    agreement : (r,)
        Medians of the noise scale over groups of consecutive frames.
    """

    frames: tuple[FrameFate, ...]
    charts: tuple[FrameChart, ...]
    bad: tuple[float, ...]
    to_look_at: tuple[FrameFate, ...]
    omitted: int
    middle: str
    agreement: Float[np.ndarray, "r"]

    @property
    def table(self) -> ReportTable:
        """Table of the frames to look at, with the reasons."""
        rows = [
            [
                frame.name,
                frame.status,
                f"{frame.tracks:.0f}" if np.isfinite(frame.tracks) else "none",
                frame.problem,
            ]
            for frame in self.to_look_at
        ]
        note = f"and {self.omitted} more; the manifest has them all." if self.omitted else ""
        return ReportTable(("frame", "status", "tracks", "why"), rows, note=note, look="frames")


def frames_part(frames: Mapping[str, Matches | None], failures: Mapping[str, str]) -> FramesPart:
    """Summarise the results of all frames, and read one frame at a time.

    frames : matches by frame name; None for a failed frame. failures : reasons by frame name.

    Raises InputError if all frames failed.
    """
    fates = tuple(_frame_fate(name, frames[name], failures.get(name, "")) for name in frames)
    good_fates = [fate for fate in fates if not fate.problem] or [
        fate for fate in fates if np.isfinite(fate.tracks)
    ]
    if not good_fates:
        raise InputError("Every frame failed: there is nothing to report but the manifest.")
    tracks = np.array([fate.tracks for fate in good_fates])
    median = float(np.median(tracks))
    middle = good_fates[int(np.argmin(np.abs(tracks - median)))].name
    few_tracks = f"fewer tracks than {percent(FEW)} of the median ({median:.0f})"
    # Where most frames are to be used with care, such as those of two views, one is not listed.
    is_usual = sum(bool(fate.care) for fate in good_fates) > len(good_fates) / 2
    fates_to_look_at = []
    for fate in fates:
        problem = fate.problem or ("" if is_usual else fate.care)
        if problem or fate.tracks < FEW * median:
            fates_to_look_at.append(fate._replace(problem=problem or few_tracks))
    fate_values = np.array([(f.tracks, f.share, f.agreement) for f in fates]).T
    tracks_chart, share_chart, agreement_chart = (_columns(row) for row in fate_values)
    most_tracks = max(float(np.nanmax(fate_values[0])), 1.0)
    noisiest = max(float(np.nanmax(fate_values[2], initial=0.0)), 2.0)
    charts = (
        FrameChart("Tracks", "0", f"{most_tracks:.0f}", tracks_chart / most_tracks),
        FrameChart("Segments on a track", "0 %", "100 %", share_chart),
        FrameChart(
            "Views apart, in sigmas",
            "0",
            with_decimals(noisiest, 1),
            agreement_chart / noisiest,
        ),
    )
    problem_positions = tuple(
        (number + 0.5) / len(fates) for number, fate in enumerate(fates) if fate.problem
    )
    return FramesPart(
        *(
            fates,
            charts,
            problem_positions,
            tuple(fates_to_look_at[:LISTED]),
            max(len(fates_to_look_at) - LISTED, 0),
            middle,
        ),
        _run_medians(np.array([fate.agreement for fate in good_fates])),
    )


def _frame_fate(name: str, matches: Matches | None, failure: str) -> FrameFate:
    if matches is None:
        return FrameFate(name, np.nan, np.nan, np.nan, failure or "failed", "failed")
    in_three = np.asarray(matches.stage) == TRINOCULAR
    assessment = assess_matches(matches)
    problem = assessment.deciding.explanation
    return FrameFate(
        name,
        float(in_three.sum() if len(matches.views) > 2 else len(matches)),
        share_matched(matches),
        float(matches.noise_scale) if in_three.any() else np.nan,
        problem if assessment.status is MatchStatus.SUSPECT else "",
        assessment.status.name.lower(),
        assessment.deciding.reason if assessment.status is MatchStatus.UNCERTAIN else "",
    )


def _columns(values: Float[np.ndarray, "f"]) -> Float[np.ndarray, "n 3"]:
    """Least, median and largest value of the frames in each column of a chart, (n, 3).

    A column stands for one frame or several consecutive ones. NaN if all frames of a column failed.
    """
    columns = []
    for part in np.array_split(values, min(COLUMNS, len(values))):
        finite = part[np.isfinite(part)]
        columns.append(np.quantile(finite, (0, 0.5, 1)) if len(finite) else [np.nan] * 3)
    return np.array(columns)


def _run_medians(values: Float[np.ndarray, "f"]) -> Float[np.ndarray, "r"]:
    finite = values[np.isfinite(values)]
    runs = min(RUNS, len(finite) // LEAST_RUN) or min(len(finite), 1)
    return np.array([np.median(run) for run in np.array_split(finite, runs)] if runs else [])
