"""A check of the report: its question, the function that answers it, and its limits."""

import enum
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.match.tracks.matches import Matches
from trinoc.report.coverage import Coverage, MeanResiduals
from trinoc.report.epipolar_part import EpipolarPart
from trinoc.report.field_part import FieldPart, Uncertainty
from trinoc.report.frames_part import FramesPart


class Level(enum.Enum):
    """Outcome of a check, the worst first; the value is its text on the page."""

    BAD = "bad"
    CARE = "take care"
    JUDGE = "for you to judge"
    GOOD = "good"


class Subject(NamedTuple):
    """The contents of a report that checks read; a check of missing contents answers None."""

    result: CalibrationResult | None = None
    shots: CalibrationResult | None = None
    matches: Matches | None = None
    doubts: Mapping[str, str] = {}
    coverage: Sequence[Coverage] = ()
    residuals: Sequence[MeanResiduals] = ()
    epipolar: Sequence[EpipolarPart] = ()
    field: FieldPart | None = None
    uncertainty: Uncertainty | None = None
    recording: FramesPart | None = None


class Answer(NamedTuple):
    """The number that is compared with the limits, as a figure and in a sentence.

    part : the part of the page to look at, if another than that of the check.
    remedy : what to do, if another than that of the check.
    """

    value: float
    figure: str
    explanation: str
    part: str = ""
    remedy: str = ""


class ReportCheck(NamedTuple):
    """One question, its answer as a figure and in a sentence, and the remedy if it is not good."""

    question: str
    level: Level
    figure: str
    explanation: str
    remedy: str
    part: str


class Limits(NamedTuple):
    """A row of the table of checks: question, function that answers it, and limits.

    Fields
    ------
    good : the largest good value, or with `at_least` the smallest; None if the reader decides.
    beyond : the level of a value that is not good; above `bad`, or not a number, it is bad.
    """

    question: str
    part: str
    good: float | None
    remedy: str
    answer: Callable[[Subject], Answer | None]
    beyond: Level = Level.CARE
    bad: float = np.inf
    at_least: bool = False

    def check(self, subject: Subject) -> ReportCheck | None:
        """The check, or None where nothing answers it."""
        answer = self.answer(subject)
        if answer is None:
            return None
        level = self._level(answer.value)
        remedy = "" if level is Level.GOOD else answer.remedy or self.remedy
        part = answer.part or self.part
        return ReportCheck(self.question, level, answer.figure, answer.explanation, remedy, part)

    def _level(self, value: float) -> Level:
        if self.good is None:
            return Level.JUDGE
        if value >= self.good if self.at_least else value <= self.good:
            return Level.GOOD
        return self.beyond if value <= self.bad else Level.BAD
