"""The same pictures with one setting of the segmentation after the other, each evaluated."""

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trinoc.errors import InputError, TrinocError
from trinoc.evaluation.evaluation import (
    TOLERANCES_MM,
    Evaluation,
    EvaluationStatus,
    evaluate,
)
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.lines_of_rig import TRACKS, certain_lines, lines_of_form
from trinoc.geometry.rig import Rig
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.match.wire_frame.frame import Wireframe
from trinoc.segments.find import find_segments


class Setting(NamedTuple):
    """Knobs of `trinoc.find_segments`."""

    tolerance_px: float = 1.6
    false_alarms: float = 1.0
    least_contrast: float = 7.0


class SweepSetting(NamedTuple):
    """Which tracks count: of a posterior or above, of all stages or of three views only; and what
    is compared: "tracks" one by one, "joined" to straight lines, these carried to "corners", or
    the edges of the "wireframe", with its corners."""

    least_posterior: float = 0.0
    stage: str = "all"
    form: str = TRACKS


class Row(NamedTuple):
    """One setting and choice, and what came of it: an evaluation, or a sentence why there is none.

    `setting` is None where matches were given; `segments` is their number in all views together.
    """

    setting: Setting | None
    choice: SweepSetting
    segments: int
    evaluation: Evaluation | None
    problem: str
    seconds: float

    def record(self) -> dict[str, Any]:
        """The row of a table, by name; NaN where there is no number."""
        knobs = {} if self.setting is None else self.setting._asdict()
        record = {**knobs, **self.choice._asdict(), "segments": self.segments}
        if self.evaluation is not None:
            record |= self.evaluation.record()
        return {**record, "seconds": round(self.seconds, 3), "problem": self.problem}


def list_settings(
    tolerance_px: Sequence[float],
    false_alarms: Sequence[float],
    least_contrast: Sequence[float],
) -> list[Setting]:
    """Every combination."""
    return [
        Setting(*knobs) for knobs in itertools.product(tolerance_px, false_alarms, least_contrast)
    ]


def evaluate_settings(
    pictures: Mapping[str, np.ndarray],
    rig: Rig,
    shape: KnownShape,
    settings: Sequence[Setting],
    choices: Sequence[SweepSetting] = (SweepSetting(),),
    *,
    tolerances_mm: Sequence[float] = TOLERANCES_MM,
    aligned: bool = False,
) -> Iterator[Row]:
    """Segments, matches and their evaluation of each setting; a row for each choice of tracks.

    A setting that fails gives rows that say why, and the next goes on.
    """
    for setting in settings:
        start = time.perf_counter()
        try:
            segments = {
                name: find_segments(picture, **setting._asdict())
                for name, picture in pictures.items()
            }
            matches = match_segments(segments, rig)
        except TrinocError as error:
            seconds = time.perf_counter() - start
            yield from (Row(setting, choice, 0, None, str(error), seconds) for choice in choices)
            continue
        seconds = time.perf_counter() - start
        for row in evaluate_matches(
            matches, rig, shape, choices, tolerances_mm=tolerances_mm, aligned=aligned
        ):
            yield row._replace(setting=setting, seconds=seconds)


def evaluate_matches(
    matches: Matches,
    rig: Rig | None,
    shape: KnownShape,
    choices: Sequence[SweepSetting] = (SweepSetting(),),
    *,
    tolerances_mm: Sequence[float] = TOLERANCES_MM,
    aligned: bool = False,
) -> Iterator[Row]:
    """A row for each choice of tracks; the cameras count as exact where no rig is given."""
    start = time.perf_counter()
    count = sum(len(words) for words in matches.reasons.values())
    for choice in choices:
        found, problem = None, ""
        try:
            lines, frame = chosen_lines(matches, rig, choice)
            found = evaluate(
                lines, shape, tolerances_mm=tolerances_mm, aligned=aligned, frame=frame
            )
        except TrinocError as error:
            problem = str(error)
        if found is not None and found.status is not EvaluationStatus.COMPARED:
            problem = found.status.value
        yield Row(None, choice, count, found, problem, time.perf_counter() - start)


def chosen_lines(
    matches: Matches, rig: Rig | None, choice: SweepSetting
) -> tuple[UncertainLines, Wireframe | None]:
    """The lines of the tracks that count, with the cameras' errors where the rig states them, and
    the wire frame, where that is asked for.

    Raises InputError where lines are to be joined and no rig is given.
    """
    kept = matches.posterior >= choice.least_posterior
    if choice.stage == TRINOCULAR:
        kept &= matches.stage == TRINOCULAR
    tracks = matches.take(np.flatnonzero(kept))
    if rig is not None:
        return lines_of_form(tracks, rig, choice.form)
    if choice.form != TRACKS:
        raise InputError("Lines are joined by what the cameras saw of them: give the rig.")
    return certain_lines(tracks.lines_mm, tracks.covariance_mm2), None
